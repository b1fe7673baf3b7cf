//! `NAME=PORT`: a sensor with a name, for the commands that take several of them.

use std::str::FromStr;

use super::name::PortName;

/// A `PORT` or `NAME=PORT` argument.
#[derive(Debug, Clone)]
pub(crate) struct NamedPort {
    pub(crate) name: Option<String>,
    pub(crate) port: PortName,
}

impl FromStr for NamedPort {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, port) = match text.split_once('=') {
            // An `=` further on belongs to the port, as in `tcp://host:1?baud=19200`.
            Some((name, port)) if !name.contains(['/', ':', '.', '?']) => {
                (Some(token(name)?.to_owned()), port)
            }
            _ => (None, text),
        };
        Ok(Self { name, port: port.parse()? })
    }
}

/// Checks a name against ROS's rules, which are also those of Prometheus' labels
/// and of what needs no quoting in a shell.
pub(crate) fn token(text: &str) -> Result<&str, String> {
    let valid = text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        && !text.contains("__");
    valid.then_some(text).ok_or_else(|| {
        format!(
            "invalid name `{text}`: expected letters, digits and single `_`, and no digit first"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_equals_sign_in_a_port_names_nothing() {
        for text in ["tcp://host:1?baud=19200", "/dev/a=b", "./a=b"] {
            let named: NamedPort = text.parse().unwrap();
            assert_eq!(named.name, None, "{text}");
        }
    }

    #[test]
    fn a_name_is_of_letters_digits_and_single_underscores() {
        let named: NamedPort = "front_2=emulated".parse().unwrap();
        assert_eq!(named.name.as_deref(), Some("front_2"));
        for text in ["1st=emulated", "=emulated", "a-b=emulated", "a__b=emulated"] {
            let refused = text.parse::<NamedPort>().unwrap_err();
            assert!(refused.contains("invalid name"), "{text}: {refused}");
        }
    }
}
