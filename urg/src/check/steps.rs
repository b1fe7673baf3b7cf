//! Steps of the self-test.

use std::time::Duration;

use tokio_scip::protocol::Text;
use tokio_scip::protocol::scip2::State;
use tokio_scip::{Error, Sensor, Version, Window};

use super::finding::{Finding, Verdict};
use super::measured::Measured;
use crate::failure::chain;
use crate::port::name::PortName;
use crate::port::open::proven_baud_rate;
use crate::recording::contents::{Contents, Row};

/// Describes the link that was found `after` this time.
pub(crate) async fn link(port: &PortName, sensor: &Sensor, after: Duration) -> Finding {
    let after = format!("after {:.1} s", after.as_secs_f64());
    let text = match proven_baud_rate(sensor).await {
        None => format!("found on {} {after}", port.line()),
        Some((rate, None)) => format!("found at {rate} baud {after}"),
        Some((_, Some(why))) => format!("found {after}; {why}"),
    };
    Finding::ok("link", text)
}

pub(crate) async fn version(sensor: &Sensor) -> Finding {
    let told = async { Ok::<_, Error>((sensor.version().await?, sensor.sensor_state().await?)) };
    match told.await {
        Ok((version, state)) => identity(&version, state.as_ref()),
        Err(error) => Finding::failed("version", chain(&error)),
    }
}

/// Judges what a sensor says of itself: whether it works, in its version or (SCIP 2) its state.
fn identity(version: &Version, state: Option<&State>) -> Finding {
    /// Parts of what sensors that work say. Others say `Trouble!! Error No. =[00->33]`.
    const WORKS: [&str; 4] = ["Normal", "works well", "is working", "no error"];
    let who = format!("{} {}, {}", version.product, version.serial_number, version.firmware);
    let status = state.map(|state| &state.diagnosis).or(version.status.as_ref());
    let status = status.map(ToString::to_string).unwrap_or_default();
    match status {
        _ if [&version.product, &version.serial_number].contains(&&Text::default()) => {
            Finding::weak("version", format!("product or serial number missing: {who}"))
        }
        status if !status.is_empty() && !WORKS.iter().any(|part| status.contains(part)) => {
            Finding::weak("version", format!("{who}; its status is {status:?}"))
        }
        _ => Finding::ok("version", who),
    }
}

/// Switches the laser off and on. The driver confirms both by asking for a measurement.
pub(crate) async fn laser(sensor: &Sensor) -> Finding {
    for (switched, state) in [(sensor.laser_off().await, "off"), (sensor.laser_on().await, "on")] {
        if let Err(error) = switched {
            return Finding::failed(
                "laser",
                format!("cannot be switched {state}: {}", chain(&error)),
            );
        }
    }
    Finding::ok("laser", "goes off and on")
}

/// Judges what a recording contains. `topic` is the one whose scans were read.
pub(crate) fn recording(contents: Contents, topic: &str) -> Vec<Finding> {
    let has_lost = contents.left_out.iter().any(|count| !count.reason.is_expected());
    let finding = |(name, value, text): Row| {
        let is_empty = value.as_array().is_none_or(Vec::is_empty);
        let verdict = match name {
            "scans" if value == 0 => Verdict::Failed,
            "complete" if value != true => Verdict::Failed,
            "gaps" | "clock" if !is_empty => Verdict::Weak,
            "times" | "sources" | "link" => Verdict::Weak,
            "left_out" if has_lost => Verdict::Weak,
            "losses" if value.as_u64() > Some(0) => Verdict::Weak,
            "sensor_clock" if value.get("jumps") != Some(&0.into()) => Verdict::Weak,
            _ => Verdict::Ok,
        };
        Finding::new(name, verdict, text)
    };
    let version = match contents.version == Version::default() {
        true => Finding::ok(
            "version",
            format!("not recorded, as by other programs: only the scans on {topic} are judged"),
        ),
        false => identity(&contents.version, None),
    };
    [version].into_iter().chain(contents.rows.into_iter().map(finding)).collect()
}

/// Streams the window for `duration`, at the rate of the motor.
pub(crate) async fn scans(sensor: &Sensor, window: Window, duration: Duration) -> Vec<Finding> {
    let measured = Measured::over(sensor, window, duration).await;
    let failed = |error| vec![Finding::failed("polls", chain(&error))];
    measured.map_or_else(failed, |measured| measured.steps())
}

#[cfg(test)]
mod tests {
    use tokio_scip::BaudRate;
    use urg_emulator::{
        Emulator, EmulatorBuilder, Fault, Faults, Firmware, Mode, Model, Values, WorldTime,
    };

    use super::*;

    /// Runs all steps. Collects the steps that are not ok, and the text of all steps.
    async fn test(
        builder: EmulatorBuilder,
        faults: Faults,
        seconds: u64,
    ) -> (Vec<(&'static str, Verdict)>, String) {
        let emulator = builder.build();
        let sensor = Sensor::builder().connect(emulator.clone()).await.unwrap();
        emulator.set_faults(faults);
        let port = "emulated".parse().unwrap();
        let mut steps = vec![link(&port, &sensor, Duration::ZERO).await, version(&sensor).await];
        steps.push(laser(&sensor).await);
        steps.extend(scans(&sensor, Window::DETECTION, Duration::from_secs(seconds)).await);
        let text = steps.iter().map(|step| format!("{step}\n")).collect();
        let bad = steps.into_iter().filter(|step| step.verdict != Verdict::Ok);
        (bad.map(|step| (step.name, step.verdict)).collect(), text)
    }

    #[test]
    fn a_finding_cannot_control_the_terminal() {
        let text = Finding::failed("laser", "/\x1b[2J.mcap").to_string();
        assert!(text.contains("\\u{1b}[2J.mcap") && !text.contains('\x1b'), "{text:?}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_good_sensor_passes_every_step() {
        let (bad, text) = test(Emulator::builder().usb(), Faults::none(), 10).await;
        assert_eq!(bad, [], "{text}");
        assert_eq!(text.lines().count(), 8, "{text}");
        let rate =
            "10.0 scans a second of 10.0, one every 100 to 100 ms, standard deviation 0.0 ms";
        assert!(text.contains(rate), "{text}");
        let fast = Emulator::builder().baud_rate(BaudRate::B750000);
        let (bad, text) = test(fast, Faults::none(), 10).await;
        assert_eq!(bad, [], "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn each_model_is_judged_at_its_own_rate() {
        for (model, rate) in
            [(Model::Urg04lxUg01, "10.0"), (Model::Utm30lx, "40.0"), (Model::Ust10lx, "40.0")]
        {
            let (bad, text) = test(Emulator::builder().model(model), Faults::none(), 10).await;
            assert_eq!(bad, [], "{model:?} {text}");
            let rate = format!(" scans a second of {rate},");
            assert!(text.contains(&rate) && !text.contains("latency"), "{model:?} {text}");
            assert!(text.contains("interval a scan follows another after "), "{model:?} {text}");
            let damaged = Faults::none().rate(0.2, Fault::Damaged).seed(1);
            let (bad, text) = test(Emulator::builder().model(model), damaged, 10).await;
            assert!(bad.contains(&("polls", Verdict::Failed)), "{model:?} {text}");
            assert!(text.contains("malformed"), "{model:?} {text}");
            let fast = Emulator::builder().model(model).clock(Duration::ZERO, 0.0012);
            let lossy = Faults::none().at(60, Fault::Lost).at(70, Fault::Lost);
            let (bad, text) = test(fast, lossy, 20).await;
            assert!(bad.contains(&("polls", Verdict::Weak)), "{model:?} {text}");
            assert!(text.contains(": 2 lost on the way"), "{model:?} {text}");
            let drift = text.split("the sensor's clock is ").nth(1).unwrap();
            let drift: f64 = drift.split(' ').next().unwrap().parse().unwrap();
            assert!(drift > 0.11 && drift < 0.13 && text.contains(" % fast"), "{model:?} {text}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn motor_speed_is_measured_and_late_scans_are_weak() {
        let turning = || Emulator::builder().intact_usb().revolution(Duration::from_micros(99_760));
        let (bad, text) = test(turning(), Faults::none(), 10).await;
        assert_eq!(bad, [], "{text}");
        assert!(text.contains("motor    601.4"), "{text}");
        let late = Faults::none().up_to(0.25, Fault::Late(Duration::from_millis(48))).seed(1);
        let jumps = Faults::none().at(300, Fault::ClockJump(500));
        let (bad, text) = test(Emulator::builder().model(Model::Utm30lx), jumps, 30).await;
        assert!(bad.contains(&("motor", Verdict::Weak)), "{text}");
        assert!(text.contains("it jumped 1 time: check the power"), "{text}");
        let (bad, text) = test(turning(), late, 120).await;
        assert!(bad.contains(&("motor", Verdict::Weak)), "{text}");
        assert!(text.contains("this computer is busy"), "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_slow_motor_is_not_blamed_on_lost_scans() {
        // As a UBG-04LX-F01 does.
        let slow = Emulator::builder().model(Model::Utm30lx).revolution(Duration::from_millis(28));
        let (bad, text) = test(slow, Faults::none(), 10).await;
        assert_eq!(bad, [("rate", Verdict::Weak)], "{text}");
        assert!(text.contains("the motor turns at 2143 rpm in place of 2400"), "{text}");
        let slower = Emulator::builder().usb().revolution(Duration::from_millis(250));
        let (bad, text) = test(slower, Faults::none(), 10).await;
        assert!(bad.contains(&("rate", Verdict::Failed)), "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_slow_line_is_weak_and_told_what_helps() {
        let slow = || Emulator::builder().baud_rate(BaudRate::B19200);
        let in_scip2 = slow().firmware(Firmware::V31).mode(Mode::Scip2);
        for (slow, takes) in [(slow(), "733 ms"), (in_scip2, "1127 ms")] {
            let (bad, text) = test(slow, Faults::none(), 10).await;
            assert_eq!(bad, [("rate", Verdict::Weak)], "{text}");
            assert!(text.contains(takes) && text.contains(", 250000 baud"), "{text}");
            assert!(text.contains("motor    not known") && !text.contains("longer"), "{text}");
        }
        let (bad, text) = test(slow(), Faults::none(), 1).await;
        assert_eq!(bad, [("rate", Verdict::Weak)], "{text}");
        assert!(text.contains("only one scan came"), "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_low_rate_after_losses_is_reported_as_losses() {
        let lossy = Faults::none().rate(0.2, Fault::Lost).seed(1);
        let (bad, text) = test(Emulator::builder().baud_rate(BaudRate::B750000), lossy, 10).await;
        assert!(bad.iter().any(|(step, _)| *step == "rate"), "{text}");
        let rate = text.lines().find(|line| line.contains(" rate ")).unwrap();
        assert!(rate.contains("polls brought no scan"), "{text}");
        assert!(!rate.contains(" baud"), "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn some_loss_is_weak_and_much_is_a_failure() {
        let one = Faults::none().at(20, Fault::Lost);
        let (bad, text) = test(Emulator::builder().usb(), one, 10).await;
        assert!(bad.contains(&("polls", Verdict::Weak)), "{text}");
        assert!(!bad.iter().any(|(_, verdict)| *verdict == Verdict::Failed), "{text}");
        assert!(text.contains("1 unanswered in time"), "{text}");
        let unplugged = Faults::none().at(20, Fault::HangUp(0));
        let (bad, text) = test(Emulator::builder().usb(), unplugged, 10).await;
        assert!(bad.contains(&("polls", Verdict::Failed)), "{text}");
        assert!(text.contains(": 1 lost link; check cable"), "{text}");
        assert!(text.contains(": the link was lost\n"), "{text}");
        let much = Faults::none().rate(0.2, Fault::Damaged).seed(1);
        let (bad, text) = test(Emulator::builder().usb(), much, 10).await;
        assert!(bad.contains(&("polls", Verdict::Failed)), "{text}");
        assert!(text.contains("malformed"), "{text}");
    }

    #[tokio::test(start_paused = true)]
    async fn reasons_explain_each_missing_scan() {
        let faults = Faults::none().rate(0.03, Fault::Lost).rate(0.02, Fault::Damaged);
        let faults = faults.up_to(0.02, Fault::Late(Duration::from_millis(1500)));
        let mut others = 0;
        for seed in 0..24 {
            let model = [Model::Urg04lx, Model::Urg04lxUg01][seed as usize % 2];
            let sensor = Emulator::builder().model(model).usb();
            let (_, text) = test(sensor, faults.clone().seed(seed), 5).await;
            let polls = text.lines().find(|line| line.contains(" polls ")).unwrap();
            let numbers: Vec<u64> = polls.split(' ').filter_map(|word| word.parse().ok()).collect();
            let has_others = usize::from(polls.contains("besides"));
            let reasons: u64 = numbers[2..numbers.len() - has_others].iter().sum();
            assert_eq!(numbers[0] + reasons, numbers[1], "{seed}: {polls}");
            others += has_others;
        }
        assert!(others > 5, "{others}");
    }

    #[tokio::test(start_paused = true)]
    async fn a_sensor_without_scans_fails() {
        let (bad, text) = test(Emulator::builder().usb(), Faults::none(), 0).await;
        assert_eq!(bad, [("polls", Verdict::Failed)], "{text}");
        let refuses = Faults::none().every(Fault::Status(b'5'));
        let (bad, text) = test(Emulator::builder().usb(), refuses, 10).await;
        assert!(bad.contains(&("polls", Verdict::Failed)), "{text}");
        assert!(text.contains(" refused\n") && !text.contains("check cable"), "{text}");
        let silent = Faults::none().every(Fault::Lost);
        let (bad, text) = test(Emulator::builder().usb(), silent, 10).await;
        assert!(bad.contains(&("laser", Verdict::Failed)), "{text}");
        assert!(bad.contains(&("polls", Verdict::Failed)), "{text}");
    }

    #[test]
    fn a_sensor_of_scip_2_that_is_in_trouble_is_weak() {
        let mut version = Version::default();
        (version.product, version.serial_number) = ("UTM-30LX".into(), "H0902680".into());
        let mut state = State::default();
        let good = "|Sensor works well.|Sensor is working well.|Stable 000 no error.|\
                    sensor is working normally";
        let good = good.split('|').map(|says| (says, Verdict::Ok));
        let bad = ["Sensor is in error state.", "Trouble!! Error No. =[00->33]"];
        for (says, verdict) in good.chain(bad.map(|says| (says, Verdict::Weak))) {
            state.diagnosis = says.into();
            let finding = identity(&version, Some(&state));
            assert_eq!(finding.verdict, verdict, "{finding}");
            assert!(verdict == Verdict::Ok || finding.to_string().contains(says), "{finding}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn limits_of_latency_and_of_equal_scans_are_good() {
        let equal = |_: WorldTime, codes: &mut Values| codes.fill(1000);
        let late = |later| (100, Faults::none().at(30, Fault::Late(Duration::from_millis(later))));
        // Slow motors bring five and six scans in a second.
        for ((period, faults), seconds, step, is_weak) in [
            (late(140), 10, "latency", false),
            (late(160), 10, "latency", true),
            ((190, Faults::none()), 1, "sight", false),
            ((160, Faults::none()), 1, "sight", true),
        ] {
            let sensor = Emulator::builder().usb().revolution(Duration::from_millis(period));
            let (bad, text) = test(sensor.world(equal), faults, seconds).await;
            assert_eq!(bad.contains(&(step, Verdict::Weak)), is_weak, "{text}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn odd_sensors_are_weak() {
        let sees = |code| {
            let world = move |_: WorldTime, codes: &mut Values| codes.fill(code);
            Emulator::builder().usb().world(world)
        };
        let broken = ["PROD:URG", "SERI:H1", "STAT:FW Laser trouble"];
        for (sensor, step) in [
            (sees(3), "sight"),
            (sees(1000), "sight"),
            (Emulator::builder().usb().version_lines(["PROT:SCIP 1.0"]), "version"),
            (Emulator::builder().usb().version_lines(broken), "version"),
        ] {
            let (bad, text) = test(sensor, Faults::none(), 10).await;
            assert_eq!(bad, [(step, Verdict::Weak)], "{text}");
        }
    }
}
