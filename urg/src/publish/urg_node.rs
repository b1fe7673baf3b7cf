//! Parameters under the names that `urg_node` and `urg_node2` give them, so that their files of
//! parameters work with `urg publish`.

use std::collections::BTreeMap;

/// Window that every sensor has inside: a bound outside of it asks for all that the sensor measures.
const FARTHEST: f64 = 135.0;
/// Default of `ip_port`.
const SENSOR_PORT: &str = "10940";

/// Values of these parameters, by their names.
#[derive(Debug, Default)]
pub(super) struct UrgNodeParameters(BTreeMap<&'static str, String>);

/// What to do with a parameter that has no effect here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Effect {
    /// It has an effect, or its value asks for nothing.
    Taken,
    /// It has none, for this reason.
    Nothing(&'static str),
    /// The nodes have no parameter of this name.
    Unknown,
}

impl UrgNodeParameters {
    /// Takes a parameter. The last value of a name applies.
    pub(super) fn take(&mut self, name: &str, value: Option<&str>) -> Result<Effect, String> {
        let names = ["ip_address", "ip_port", "serial_port", "serial_baud"];
        let names = names.iter().chain(&["angle_min", "angle_max", "skip", "publish_intensity"]);
        if let Some(known) = names.copied().find(|known| *known == name) {
            // The files have an empty `ip_address` for a serial port.
            let value = value.ok_or_else(|| format!("expected one value for {name}"))?;
            self.0.insert(known, value.to_owned());
            return Ok(Effect::Taken);
        }
        let is_off = value.and_then(boolean) == Some(false);
        Ok(match name {
            "calibrate_time" | "synchronize_time" | "publish_multiecho" | "get_detailed_status"
                if is_off =>
            {
                Effect::Taken
            }
            "calibrate_time" | "synchronize_time" => {
                Effect::Nothing("the stamp is the time of the first ray, see --time-offset")
            }
            "publish_multiecho" => Effect::Nothing("scans have the first echo"),
            "get_detailed_status" => Effect::Nothing("no safety scanner is supported"),
            "error_limit" | "error_reset_period" => {
                Effect::Nothing("the driver recovers from each error by itself")
            }
            "diagnostics_tolerance" | "diagnostics_window_time" => {
                Effect::Nothing("a rate below 95 % over three seconds is a warning")
            }
            _ => Effect::Unknown,
        })
    }

    /// Returns true if the node is started in place of one of these.
    pub(super) fn are_used(&self) -> bool {
        !self.0.is_empty()
    }

    /// Options that mean the same.
    pub(super) fn options(&self) -> Result<Vec<String>, String> {
        let value = |name| self.0.get(name).map(String::as_str).filter(|value| !value.is_empty());
        let mut options = Vec::new();
        if let Some(host) = value("ip_address") {
            let port = value("ip_port").unwrap_or(SENSOR_PORT);
            let host = if host.contains(':') { format!("[{host}]") } else { host.to_owned() };
            options.push(format!("--port=tcp://{host}:{port}"));
        } else {
            options.extend(value("serial_port").map(|port| format!("--port={port}")));
            options.extend(value("serial_baud").map(|rate| format!("--baud={rate}")));
        }
        for (name, option) in [("angle_min", "from"), ("angle_max", "to")] {
            let Some(text) = value(name) else { continue };
            let radians: f64 =
                text.parse().map_err(|_| format!("expected radians for {name}, found `{text}`"))?;
            let degrees = radians.to_degrees();
            if degrees.abs() < FARTHEST {
                options.push(format!("--{option}={degrees}"));
            }
        }
        options.extend(value("skip").map(|scans| format!("--skip={scans}")));
        if let Some(text) = value("publish_intensity") {
            let expected = "expected true or false for publish_intensity";
            let is_on = boolean(text).ok_or_else(|| format!("{expected}, found `{text}`"))?;
            options.extend(is_on.then(|| "--intensity".to_owned()));
        }
        Ok(options)
    }
}

/// Boolean of YAML 1.1, as ROS reads it.
fn boolean(text: &str) -> Option<bool> {
    match text.to_ascii_lowercase().as_str() {
        "true" | "yes" | "on" | "y" => Some(true),
        "false" | "no" | "off" | "n" => Some(false),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(parameters: &[(&str, &str)]) -> Result<Vec<String>, String> {
        let mut taken = UrgNodeParameters::default();
        for (name, value) in parameters {
            assert_eq!(taken.take(name, Some(value)), Ok(Effect::Taken), "{name}");
        }
        taken.options()
    }

    #[test]
    fn a_connection_is_a_port() {
        let port = |parameters: &[_]| options(parameters).unwrap().join(" ");
        assert_eq!(port(&[("ip_address", "10.0.0.7")]), "--port=tcp://10.0.0.7:10940");
        assert_eq!(
            port(&[("ip_address", "fe80::1"), ("ip_port", "1"), ("serial_baud", "115200")]),
            "--port=tcp://[fe80::1]:1"
        );
        let serial =
            [("ip_address", ""), ("serial_port", "/dev/ttyUSB0"), ("serial_baud", "57600")];
        assert_eq!(port(&serial), "--port=/dev/ttyUSB0 --baud=57600");
    }

    #[test]
    fn angles_are_radians_and_a_turn_is_everything() {
        let whole = [("angle_min", "-3.14"), ("angle_max", "3.14")];
        assert_eq!(options(&whole), Ok(Vec::new()));
        let options_of = options(&[("angle_min", "-3.14"), ("angle_max", "1.0")]).unwrap();
        let to: f64 = options_of[0].strip_prefix("--to=").unwrap().parse().unwrap();
        assert!((to - 57.295_78).abs() < 1e-3, "{to}");
        assert!(options(&[("angle_min", "left")]).unwrap_err().contains("expected radians"));
    }

    #[test]
    fn intensities_are_on_or_off() {
        assert_eq!(options(&[("publish_intensity", "True")]), Ok(vec!["--intensity".to_owned()]));
        let twice = [("publish_intensity", "true"), ("publish_intensity", "off")];
        assert_eq!(options(&twice), Ok(Vec::new()));
        let error = options(&[("publish_intensity", "much")]).unwrap_err();
        assert!(error.contains("expected true or false"), "{error}");
    }

    #[test]
    fn what_changes_nothing_is_told_unless_it_is_off() {
        let mut taken = UrgNodeParameters::default();
        assert_eq!(taken.take("calibrate_time", Some("False")), Ok(Effect::Taken));
        for name in ["calibrate_time", "publish_multiecho"] {
            let effect = taken.take(name, Some("true")).unwrap();
            assert!(matches!(effect, Effect::Nothing(_)), "{name}");
        }
        assert_eq!(taken.take("colour", Some("1")), Ok(Effect::Unknown));
        assert!(taken.take("skip", None).is_err());
        assert_eq!(taken.options(), Ok(Vec::new()));
    }
}
