//! The emulated sensor's replies, compared with the table in its documentation.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::timeout;
use urg_emulator::{EmptyCommand, Emulator, Firmware, Fixed, Pace, RepeatedLaser};

use super::script::Script;

const PARTS: [&[u8]; 16] = [
    b"V",
    b"L0",
    b"L1",
    b"S0576000000000",
    b"S115200abcdefg",
    b"S0384000000000",
    b"G00000801",
    b"G10010902",
    b"G38438400",
    b"G38438301",
    b"G70076803",
    b"G",
    b"000",
    b"SCIP2.0",
    b"QT",
    b"L",
];

/// Expected replies of a sensor on USB that measures 1234 mm everywhere.
struct Model {
    firmware: Firmware,
    empty: EmptyCommand,
    laser: bool,
    repeated: RepeatedLaser,
}

impl Model {
    fn answer(&mut self, line: &[u8]) -> Vec<u8> {
        let kept = &line[..line.len().min(64)];
        let reply = |status: &str| [kept, b"\n", status.as_bytes(), b"\n\n"].concat();
        if line.is_empty() {
            return match self.empty {
                EmptyCommand::Silence => Vec::new(),
                EmptyCommand::Status => b"\nE\n\n".to_vec(),
                _ => b"\n\n".to_vec(),
            };
        }
        let real = self.firmware == Firmware::V3;
        match line {
            b"V" => match real {
                true => reply(
                    "0\nVEND:Hokuyo Automatic Co.,Ltd.\nPROD:SOKUIKI Sensor URG-04LX\nFIRM:3.3.00,08/04/16(20-4095[mm],240[deg],44-725[step],600[rpm])\nPROT:00003,(SCIP 1.0)\nSERI:H1\nSTAT:FW Normal[FinalDist with shadow  ]",
                ),
                false => reply(
                    "0\nVEND: Hokuyo Automatic Co., Ltd.\nPROD: SOKUIKI Sensor URG-X002\nFIRM: 0.01.22a,(2004/12/27)\nPROT: 00001,(SCIP 1.0)\nSERI: H1",
                ),
            },
            b"SCIP2.0" if real => reply("C"),
            b"SCIP2.0" => Vec::new(),
            b"L0" | b"L1" => {
                let on = line == b"L1";
                let is_repeated = std::mem::replace(&mut self.laser, on) == on;
                let refuses = is_repeated && self.repeated == RepeatedLaser::Status2;
                reply(if refuses { "2" } else { "0" })
            }
            [b'L', _] => reply("4"),
            [b'S', digits @ ..] if digits.len() == 13 => match &digits[..6] {
                b"019200" | b"057600" | b"115200" | b"250000" | b"500000" | b"750000" => {
                    reply(if real { "3" } else { "0" })
                }
                _ => reply("4"),
            },
            [b'G', digits @ ..] if digits.len() == 8 => {
                let number = |digits: &[u8]| {
                    let digits = digits.iter().all(u8::is_ascii_digit).then_some(digits)?;
                    std::str::from_utf8(digits).ok()?.parse::<usize>().ok()
                };
                let parts = (number(&digits[..3]), number(&digits[3..6]), number(&digits[6..]));
                match parts {
                    (Some(start @ 0..=768), Some(end @ 0..=768), Some(cluster)) => {
                        if !self.laser && start <= end {
                            return reply("6");
                        }
                        if start > end {
                            return reply("5");
                        }
                        let points = (end - start + 1).div_ceil(cluster.max(1));
                        let data = b"CB".repeat(points);
                        let lines: Vec<&[u8]> = data.chunks(64).collect();
                        [kept, b"\n0\n", &lines.join(&b'\n'), b"\n\n"].concat()
                    }
                    _ => reply("4"),
                }
            }
            [b'V' | b'L' | b'S' | b'G', ..] => reply("1"),
            _ if real => reply("E"),
            _ => Vec::new(),
        }
    }
}

/// Whatever bytes arrive, in whatever pieces, the sensor answers every line as the table
/// requires, in order, and sends nothing else.
pub(crate) fn every_line_is_answered_as_the_table_says(script: &[u8]) {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = runtime.enable_time().start_paused(true).build().unwrap();
    runtime.block_on(talk(Script::new(script)));
}

async fn talk(mut script: Script<'_>) {
    let kind = script.byte();
    let firmware = if kind & 1 == 0 { Firmware::V3 } else { Firmware::Text };
    let empty = [EmptyCommand::Silence, EmptyCommand::Status, EmptyCommand::LineFeeds];
    let empty = empty[usize::from(kind >> 1) % 3];
    let pace = if kind & 0x80 == 0 { Pace::AtOnce } else { Pace::PerRevolution };
    let repeated = [RepeatedLaser::Status2, RepeatedLaser::Status0][usize::from(kind >> 6) % 2];
    let emulator = Emulator::builder()
        .firmware(firmware)
        .repeated_laser(repeated)
        .empty_command(empty)
        .serial_number("H1")
        .world(Fixed::filled(1234))
        .pace(pace)
        .build();
    let mut model = Model { firmware, empty, laser: true, repeated };
    let (mut link, mut line, mut commands) = (emulator.link(), Vec::new(), 0);
    while !script.is_over() {
        // At most this much at a time, because a sensor's input buffer is small.
        let (mut sent, mut expected, mut waiting) = (Vec::new(), Vec::new(), 0);
        while !script.is_over() && waiting < 8 && sent.len() < 200 {
            let part = match script.byte() {
                part @ 0..0x60 => PARTS[usize::from(part) % PARTS.len()],
                0x60..0xb0 => b"\n",
                0xb0..0xc0 => b"\r",
                0xc0..0xd0 => break,
                length => script.take(usize::from(length) % 8),
            };
            sent.extend_from_slice(part);
            for &byte in part {
                match byte {
                    b'\n' | b'\r' => {
                        expected.extend(model.answer(&std::mem::take(&mut line)));
                        waiting += 1;
                    }
                    byte => line.push(byte),
                }
            }
        }
        commands += waiting;
        link.write_all(&sent).await.unwrap();
        let mut answer = Vec::new();
        // Each command may take two revolutions, answered or not.
        while timeout(Duration::from_secs(2), link.read_buf(&mut answer)).await.is_ok() {}
        assert_eq!(answer.escape_ascii().to_string(), expected.escape_ascii().to_string());
    }
    let counts = emulator.counts();
    assert_eq!((counts.commands, counts.overrun, counts.garbled), (commands, 0, 0));
    assert_eq!(emulator.is_laser_on(), model.laser);
}
