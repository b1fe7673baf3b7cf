//! Replies, byte by byte.

use tokio::io::AsyncWriteExt;
use tokio_scip::BaudRate;
use urg_emulator::{EmptyCommand, Firmware, Fixed, Mode, RepeatedLaser, Values, WorldTime};

use super::{ask, instant_sensor, listen};

#[tokio::test(start_paused = true)]
async fn the_texts_firmware_replies_to_v_with_five_lines() {
    let emulator = instant_sensor().firmware(Firmware::Text).serial_number("H0400000").build();
    let expected = "V\n0\n\
        VEND: Hokuyo Automatic Co., Ltd.\n\
        PROD: SOKUIKI Sensor URG-X002\n\
        FIRM: 0.01.22a,(2004/12/27)\n\
        PROT: 00001,(SCIP 1.0)\n\
        SERI: H0400000\n\n";
    assert_eq!(ask(&mut emulator.link(), "V").await, expected);
}

#[tokio::test(start_paused = true)]
async fn firmware_3_answers_v_with_six_lines() {
    let reply = ask(&mut instant_sensor().build().link(), "V").await;
    let expected = "V\n0\n\
        VEND:Hokuyo Automatic Co.,Ltd.\n\
        PROD:SOKUIKI Sensor URG-04LX\n\
        FIRM:3.3.00,08/04/16(20-4095[mm],240[deg],44-725[step],600[rpm])\n\
        PROT:00003,(SCIP 1.0)\n\
        SERI:H0713090\n\
        STAT:FW Normal[FinalDist with shadow  ]\n\n";
    assert_eq!(reply, expected);
    assert_eq!(reply.len(), 206);
}

#[tokio::test(start_paused = true)]
async fn version_lines_can_be_anything() {
    let emulator = instant_sensor().version_lines([&b"VEND:\x1b[31m"[..], b"caf\xe9"]).build();
    let mut link = emulator.link();
    link.write_all(b"V\n").await.unwrap();
    assert_eq!(super::listen_bytes(&mut link).await, b"V\n0\nVEND:\x1b[31m\ncaf\xe9\n\n");
}

#[tokio::test(start_paused = true)]
async fn the_laser_switches_off_and_on() {
    let emulator = instant_sensor().build();
    let mut link = emulator.link();
    assert!(emulator.is_laser_on());
    for (command, reply, laser) in [
        ("L1", "L1\n2\n\n", true),
        ("L0", "L0\n0\n\n", false),
        ("L0", "L0\n2\n\n", false),
        ("G38438401", "G38438401\n6\n\n", false),
        ("L1", "L1\n0\n\n", true),
        ("G38438401", "G38438401\n0\nCB\n\n", true),
    ] {
        assert_eq!(ask(&mut link, command).await, reply);
        assert_eq!(emulator.is_laser_on(), laser);
    }
}

#[tokio::test(start_paused = true)]
async fn carriage_return_and_line_feed_end_commands() {
    let mut link = instant_sensor().build().link();
    link.write_all(b"L0\r").await.unwrap();
    assert_eq!(listen(&mut link).await, "L0\n0\n\n");
    // CR LF is a command and an empty command.
    link.write_all(b"L1\r\n").await.unwrap();
    assert_eq!(listen(&mut link).await, "L1\n0\n\n");
    assert_eq!(listen(&mut link).await, "");
}

#[tokio::test(start_paused = true)]
async fn the_texts_example_of_1234_mm() {
    // 0x4D2 is 010011 010010, 0x13 and 0x12, and with 0x30 added 0x43 and 0x42.
    let reply = ask(&mut instant_sensor().build().link(), "G38438401").await;
    assert_eq!(reply.as_bytes(), b"G38438401\n0\n\x43\x42\n\n");
}

#[tokio::test(start_paused = true)]
async fn data_are_cut_into_lines_of_64_bytes() {
    let mut link = instant_sensor().build().link();
    let line = "CB".repeat(32);
    for (command, data) in [
        ("G00003001", "CB".repeat(31)),
        ("G00003101", line.clone()),
        ("G00003201", format!("{line}\nCB")),
        ("G00006301", format!("{line}\n{line}")),
        ("G00006401", format!("{line}\n{line}\nCB")),
    ] {
        assert_eq!(ask(&mut link, command).await, format!("{command}\n0\n{data}\n\n"));
    }
}

#[tokio::test(start_paused = true)]
async fn a_full_scan_has_1576_bytes() {
    let mut link = instant_sensor().build().link();
    let reply = ask(&mut link, "G00076801").await;
    assert_eq!(reply.len(), 1576);
    let lines: Vec<&str> = reply.trim_end().split('\n').skip(2).collect();
    assert_eq!(lines.len(), 25);
    assert!(lines[..24].iter().all(|line| line.len() == 64));
    assert_eq!(lines[24].len(), 2);
    assert_eq!(ask(&mut link, "G04472501").await.len(), 1399);
    assert_eq!(ask(&mut link, "G04472502").await.len(), 706);
}

#[tokio::test(start_paused = true)]
async fn a_cluster_has_its_smallest_value() {
    let mut codes = [0; 769];
    for (step, code) in codes.iter_mut().enumerate() {
        *code = 64 * step as u32 % 4096;
    }
    codes[3] = 7;
    let mut link = instant_sensor().world(Fixed::new(codes)).build().link();
    // The values of steps 2 to 6 are 128, 7, 256, 320 and 384.
    for (command, data) in [
        ("G00200601", "2007405060"),
        ("G00200602", "074060"),
        ("G00200603", "0750"),
        ("G00200605", "07"),
        ("G00200699", "07"),
    ] {
        assert_eq!(ask(&mut link, command).await, format!("{command}\n0\n{data}\n\n"));
    }
}

#[tokio::test(start_paused = true)]
async fn cluster_00_works_like_01() {
    let reply = ask(&mut instant_sensor().build().link(), "G10010200").await;
    assert_eq!(reply, "G10010200\n0\nCBCBCB\n\n");
}

#[tokio::test(start_paused = true)]
async fn an_invalid_command_is_echoed_with_an_error_status() {
    let mut link = instant_sensor().firmware(Firmware::Text).build().link();
    for (command, status) in [
        ("G10009901", '5'),
        ("G00076901", '4'),
        ("G-0100001", '4'),
        ("G0007680", '1'),
        ("G000768011", '1'),
        ("V1", '1'),
        ("L", '1'),
        ("L2", '4'),
        ("L10", '1'),
        ("S057600", '1'),
        ("S0384000000000", '4'),
    ] {
        assert_eq!(ask(&mut link, command).await, format!("{command}\n{status}\n\n"));
    }
}

#[tokio::test(start_paused = true)]
async fn an_undefined_command_gets_silence_or_status_e() {
    let mut text = instant_sensor().firmware(Firmware::Text).build().link();
    assert_eq!(ask(&mut text, "X").await, "");
    assert_eq!(ask(&mut text, "SCIP2.0").await, "");
    assert_eq!(ask(&mut text, "L0").await, "L0\n0\n\n");
    let mut third = instant_sensor().firmware(Firmware::V3).build().link();
    assert_eq!(ask(&mut third, "X").await, "X\nE\n\n");
}

#[tokio::test(start_paused = true)]
async fn an_empty_command_gets_one_of_three_replies() {
    for (empty, reply) in [
        (EmptyCommand::Silence, ""),
        (EmptyCommand::Status, "\nE\n\n"),
        (EmptyCommand::LineFeeds, "\n\n"),
    ] {
        let mut link = instant_sensor().empty_command(empty).build().link();
        assert_eq!(ask(&mut link, "").await, reply);
        assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n");
    }
}

#[tokio::test(start_paused = true)]
async fn a_line_feed_ends_a_half_typed_command() {
    let mut link = instant_sensor().build().link();
    link.write_all(b"G0007").await.unwrap();
    assert_eq!(ask(&mut link, "").await, "G0007\n1\n\n");
    link.write_all(b"G0007").await.unwrap();
    assert_eq!(ask(&mut link, "V").await, "G0007V\n1\n\n");
}

#[tokio::test(start_paused = true)]
async fn an_over_long_command_is_cut_and_refused() {
    let mut link = instant_sensor().build().link();
    let reply = ask(&mut link, &"V".repeat(100_000)).await;
    assert_eq!(reply, format!("{}\n1\n\n", "V".repeat(64)));
}

#[tokio::test(start_paused = true)]
async fn on_usb_a_baud_rate_has_no_effect() {
    let text = instant_sensor().firmware(Firmware::Text).build();
    assert_eq!(ask(&mut text.link(), "S1152000000000").await, "S1152000000000\n0\n\n");
    let third = instant_sensor().build();
    assert_eq!(ask(&mut third.link(), "S1152000000000").await, "S1152000000000\n3\n\n");
    assert_eq!((text.baud_rate(), third.baud_rate()), (None, None));
}

#[tokio::test(start_paused = true)]
async fn on_rs232_the_reserved_area_is_echoed_and_ignored() {
    let emulator = instant_sensor().baud_rate(BaudRate::B19200).build();
    let mut link = emulator.link();
    assert_eq!(ask(&mut link, "S019200abc!xyz").await, "S019200abc!xyz\n3\n\n");
    assert_eq!(ask(&mut link, "S057600abc!xyz").await, "S057600abc!xyz\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn a_miscounting_firmware_sends_a_point_more_or_less() {
    let mut more = instant_sensor().miscount(1).build().link();
    assert_eq!(ask(&mut more, "G10010101").await, "G10010101\n0\nCBCBCB\n\n");
    // No step follows 768, so the surplus point is error code 19.
    assert_eq!(ask(&mut more, "G76876801").await, "G76876801\n0\nCB0C\n\n");
    let mut less = instant_sensor().miscount(-1).build().link();
    assert_eq!(ask(&mut less, "G10010101").await, "G10010101\n0\nCB\n\n");
    assert_eq!(ask(&mut less, "G10010001").await, "G10010001\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn scip_2_statuses_have_three_characters() {
    let emulator = instant_sensor().mode(Mode::Scip2).build();
    let mut link = emulator.link();
    for command in ["V", "L1", "G04472501", "S1152000000000", "X"] {
        assert_eq!(ask(&mut link, command).await, format!("{command}\n0Ee\n\n"));
    }
    emulator.power_cycle();
    assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n");
}

/// Clients of newer sensors ask for SCIP 2 first, and fall back if it is refused.
#[tokio::test(start_paused = true)]
async fn scip_2_is_refused() {
    let mut link = instant_sensor().build().link();
    for (command, status) in [
        ("SCIP2.0", "C"),
        ("VV", "1"),
        ("PP", "E"),
        ("II", "E"),
        ("BM", "E"),
        ("QT", "E"),
        ("GD0044072501", "1"),
        ("MD0044072501000", "E"),
    ] {
        assert_eq!(ask(&mut link, command).await, format!("{command}\n{status}\n\n"));
        assert_eq!(ask(&mut link, "L1").await, "L1\n2\n\n", "after {command}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_laser_already_switched_answers_0_or_2() {
    assert_eq!(RepeatedLaser::default(), RepeatedLaser::Status0, "which all clients accept");
    for (setting, status) in [(RepeatedLaser::Status0, '0'), (RepeatedLaser::Status2, '2')] {
        let emulator = instant_sensor().repeated_laser(setting).build();
        let mut link = emulator.link();
        for (command, expected, is_on) in
            [("L1", status, true), ("L0", '0', false), ("L0", status, false), ("L1", '0', true)]
        {
            assert_eq!(ask(&mut link, command).await, format!("{command}\n{expected}\n\n"));
            assert_eq!(emulator.is_laser_on(), is_on);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn scip_2_scans_stream_until_stopped() {
    let emulator = instant_sensor().mode(Mode::Scip2Streaming).build();
    let mut link = emulator.link();
    for _ in 0..3 {
        let frame = listen(&mut link).await;
        assert!(frame.starts_with("MD0044072501000\n99b\n"), "{frame}");
        // 682 points of three characters, in lines of 64 with a check character each.
        assert_eq!(frame.len(), 16 + 4 + 6 + 682 * 3 + 32 * 2 + 1);
    }
    assert_eq!(ask(&mut link, "QT").await, "QT\n00P\n\n");
    assert_eq!(listen(&mut link).await, "");
}

#[tokio::test(start_paused = true)]
async fn the_request_number_counts_scans_only() {
    let world = |time: WorldTime, codes: &mut Values| codes.fill(100 + time.request as u32);
    let mut link = instant_sensor().world(world).build().link();
    for (command, reply) in [
        ("G00000001", "G00000001\n0\n1T\n\n"),
        ("G00000001", "G00000001\n0\n1U\n\n"),
        ("L1", "L1\n2\n\n"),
        ("G00000001", "G00000001\n0\n1V\n\n"),
    ] {
        assert_eq!(ask(&mut link, command).await, reply);
    }
}

#[tokio::test(start_paused = true)]
async fn the_smallest_and_the_largest_value_have_two_characters() {
    let mut link = instant_sensor().world(Fixed::new([0, 4095])).build().link();
    assert_eq!(ask(&mut link, "G00000101").await, "G00000101\n0\n00oo\n\n");
}
