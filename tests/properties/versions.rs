//! The reply to `V`: no line of it is lost, and its text is safe to display.

use tokio_scip::protocol::{Command, Reply, Text, Version};

use super::script::Script;

const PARTS: [&[u8]; 16] = [
    b"VEND:",
    b"PROD:",
    b"FIRM:",
    b"PROT:",
    b"SERI:",
    b"STAT:",
    b": ",
    b"\n",
    b"(",
    b")",
    b",",
    b"44-725[step]",
    b"600[rpm]",
    b"20-4095[mm]",
    b"240[deg]",
    b"-",
];

/// Every line of a reply to `V` is in the field of its name (the last line of each name),
/// or among the others, unchanged.
pub(crate) fn every_line_of_a_version_is_kept(script: &[u8]) {
    let mut script = Script::new(script);
    let mut frame = b"V\n0\n".to_vec();
    while !script.is_over() {
        match script.byte() {
            part @ 0..0x80 => frame.extend_from_slice(PARTS[usize::from(part) % PARTS.len()]),
            length => frame.extend_from_slice(script.take(usize::from(length) % 16)),
        }
    }
    let Ok(reply) = Reply::parse(&Command::Version, &frame) else {
        assert_eq!(frame.len(), 4);
        return;
    };
    let version = Version::from_reply(&reply);

    let named = |line: &&[u8]| line.len() > 4 && line[4] == b':';
    let value = |name: &[u8]| {
        let lines = frame[4..].split(|&byte| byte == b'\n');
        let last = lines.filter(named).rfind(|line| &line[..4] == name);
        last.map(|line| Text::from(line[5..].trim_ascii()))
    };
    let fields = [
        (&b"VEND"[..], &version.vendor),
        (b"PROD", &version.product),
        (b"FIRM", &version.firmware),
        (b"PROT", &version.protocol),
        (b"SERI", &version.serial_number),
    ];
    for (name, field) in fields {
        assert_eq!(*field, value(name).unwrap_or_default());
    }
    assert_eq!(version.status, value(b"STAT"));
    let known = |line: &&[u8]| {
        named(line) && fields.iter().any(|(name, _)| *name == &line[..4])
            || line.starts_with(b"STAT:")
    };
    let others =
        frame[4..].split(|&byte| byte == b'\n').filter(|line| !line.is_empty() && !known(line));
    assert!(others.map(Text::from).eq(version.other.iter().cloned()));

    if let Some(found) = &version.specification {
        assert!(found.steps.iter().chain(&found.range).all(|range| range.start() <= range.end()));
        assert_ne!(found.motor_speed, Some(0));
    }
    let shown = format!("{version:?}");
    assert!(shown.bytes().all(|byte| (b' '..=b'~').contains(&byte)), "{shown}");
}
