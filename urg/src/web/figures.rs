//! Figures of the driver under Prometheus' names: base units, and `_total` at the end of counters.

use tokio_scip::Stats;
use tokio_scip::stats::ScheduleStats;

use super::metrics::Families;

impl Families {
    /// Adds all figures of a sensor, each with the labels `own`. Leaves out unknown ones: latencies
    /// before the first reply, and the rate of a stream in its first three seconds.
    pub(super) fn stats(&mut self, own: &[String], stats: &Stats) {
        let failed = stats.malformed.total();
        for (name, help, value) in [
            ("urg_polls_total", "Polls sent to the sensor", stats.polls),
            ("urg_scans_total", "Scans received from the sensor", stats.scans),
            ("urg_repeats_total", "Scans equal to the one before", stats.repeats),
            ("urg_fences_total", "Fences sent", stats.fences),
            ("urg_fence_timeouts_total", "Fences without an answer", stats.fence_timeouts),
            ("urg_disconnects_total", "Losses of the link", stats.disconnects),
            ("urg_reconnects_total", "Returns of the link", stats.reconnects),
            ("urg_lost_total", "Scans of a SCIP 2 stream that did not arrive whole", stats.lost),
            ("urg_missed_total", "Scans that slow consumers missed", stats.missed),
            ("urg_polls_skipped_total", "Polls that were not sent in time", stats.polls_skipped),
            ("urg_skipped_bytes_total", "Bytes that were in no reply", stats.bytes_skipped),
        ] {
            self.add((name, "counter", help), "", own, value);
        }
        let labelled = |label: &str, value: &str| [own, &[format!("{label}=\"{value}\"")]].concat();
        for (cause, value) in
            [("timeout", stats.timeouts), ("malformed", failed), ("refused", stats.refused)]
        {
            let help = "Commands without a good reply, by cause";
            let family = ("urg_poll_failures_total", "counter", help);
            self.add(family, "", &labelled("cause", cause), value);
        }
        for (fault, value) in [
            ("echo", stats.malformed.echo),
            ("status", stats.malformed.status),
            ("length", stats.malformed.length),
            ("character", stats.malformed.character),
            ("overlong", stats.malformed.overlong),
            ("line", stats.malformed.line),
        ] {
            let family = ("urg_malformed_total", "counter", "Malformed replies, by fault");
            self.add(family, "", &labelled("fault", fault), value);
        }
        let help = "1 if replies came faster than the baud rate of the port carries, else 0";
        let disproved = u8::from(stats.baud_rate_disproved);
        self.add(("urg_baud_rate_disproved", "gauge", help), "", own, disproved);
        let latency = &stats.reply_latency;
        if latency.count > 0 {
            let help = "Time from a poll to its whole reply; in a SCIP 2 stream, between scans";
            let family = ("urg_reply_latency_seconds", "summary", help);
            for (label, q) in [("0.5", 0.5), ("0.9", 0.9), ("0.99", 0.99), ("1", 1.0)] {
                let value = latency.quantile(q).as_secs_f64();
                self.add(family, "", &labelled("quantile", label), value);
            }
            self.add(family, "_sum", own, latency.total.as_secs_f64());
            self.add(family, "_count", own, latency.count);
        }
        if let Some(motor) = stats.motor {
            let help = "Measured time of a revolution of the motor";
            let revolution = motor.revolution.as_secs_f64();
            self.add(("urg_motor_revolution_seconds", "gauge", help), "", own, revolution);
            let help = "Jumps of the motor's phase since the link was found";
            self.add(("urg_motor_jumps", "gauge", help), "", own, motor.jumps);
        }
        for ScheduleStats { window, rate, reached, .. } in &stats.schedules {
            if let Some(reached) = reached {
                let stream = [format!("window=\"{window}\""), format!("rate=\"{rate}\"")];
                let family = ("urg_scan_rate_hertz", "gauge", "Scans a second over some seconds");
                self.add(family, "", &[own, &stream].concat(), reached);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use tokio_scip::{Rate, Sensor, Window};
    use urg_emulator::Emulator;

    use super::*;

    fn text(stats: &Stats) -> String {
        let mut families = Families::default();
        families.stats(&[], stats);
        families.text()
    }

    #[test]
    fn unknown_figures_are_left_out() {
        let text = text(&Stats::default());
        assert!(text.contains("urg_scans_total 0\n"), "{text}");
        for unknown in ["urg_scan_rate_hertz", "urg_reply_latency_seconds", "urg_motor"] {
            assert!(!text.contains(unknown), "{unknown} in {text}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn known_figures_have_their_labels() {
        let sensor = Sensor::builder().connect(Emulator::builder().intact_usb().build()).await;
        let sensor = sensor.unwrap();
        let mut scans = sensor.scans(Window::FULL, Rate::hz(10.0)).await.unwrap();
        for _ in 0..40 {
            scans.next().await.unwrap().unwrap();
        }
        let mut stats = sensor.stats();
        (stats.malformed.echo, stats.malformed.line, stats.refused, stats.lost) = (1, 3, 2, 5);
        let text = text(&stats);
        for line in [
            "urg_scans_total 40\n",
            "urg_lost_total 5\n",
            "urg_malformed_total{fault=\"echo\"} 1\n",
            "urg_malformed_total{fault=\"line\"} 3\n",
            "urg_poll_failures_total{cause=\"malformed\"} 4\n",
            "urg_poll_failures_total{cause=\"refused\"} 2\n",
            "urg_reply_latency_seconds_count 40\n",
            "urg_scan_rate_hertz{window=\"steps 0..=768\",rate=\"10 Hz\"} ",
            "urg_motor_jumps 0\n",
        ] {
            assert!(text.contains(line), "{line} in {text}");
        }
        // Prometheus reserves both ends for a summary.
        for line in text.lines().filter_map(|line| line.strip_prefix("# TYPE ")) {
            assert_eq!(line.ends_with("_total counter"), line.ends_with(" counter"), "{line}");
        }
    }
}
