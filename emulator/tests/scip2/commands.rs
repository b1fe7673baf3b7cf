//! Each command and its errors.

use std::time::Duration;

use tokio::io::AsyncWriteExt;
use tokio::time::{Instant, sleep};
use tokio_scip::BaudRate;
use urg_emulator::{Emulator, Firmware, Fixed, Model, Quirk, Verdict};

use super::sensor;
use crate::{ask, listen};

/// What a real URG-04LX sent, except for its serial number.
#[tokio::test(start_paused = true)]
async fn a_urg_04lx_answers_as_captured() {
    let emulator = Emulator::builder()
        .firmware(Firmware::V31)
        .serial_number("H0706400")
        .clock(Duration::from_millis(0x1957 - 500), 0.0)
        .build();
    let mut link = emulator.link();
    assert!(emulator.is_laser_on());
    for (command, reply) in [
        (
            "V",
            "0\nVEND:Hokuyo Automatic Co.,Ltd.\nPROD:SOKUIKI Sensor URG-04LX\n\
             FIRM:3.1.04,07/08/02(20-4095[mm],240[deg],44-725[step],600[rpm])\n\
             PROT:00003,(SCIP 1.0)\nSERI:H0706400\nSTAT:FW Normal[FinalDist with shadow  ]",
        ),
        ("SCIP2.0", "0"),
        (
            "VV",
            "00P\nVEND:Hokuyo Automatic Co.,Ltd.;[\nPROD:SOKUIKI Sensor URG-04LX;[\n\
             FIRM:3.1.04(02/Aug./2007);a\nPROT:SCIP 2.0;N\nSERI:H0706400;F",
        ),
        (
            "PP",
            "00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nDMIN:20;4\nDMAX:5600;_\nARES:1024;\\\n\
             AMIN:44;7\nAMAX:725;o\nAFRT:384;6\nSCAN:600;e",
        ),
        (
            "II",
            "00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nLASR:OFF;7\n\
             SCSP:Initial(600[rpm])<-Default setting by user;A\nMESM:IDLE;:\n\
             SBPS:19200[bps]<-Default setting by user;A\nTIME:001957;O\nSTAT:Sensor works well.;8",
        ),
        ("BM", "00P"),
        ("CR00", "03S"),
        ("HS0", "0Cc"),
    ] {
        assert_eq!(ask(&mut link, command).await, format!("{command}\n{reply}\n\n"));
    }
    assert!(ask(&mut link, "II").await.contains("\nLASR:ON;9\n"));
    assert!(ask(&mut link, "II").await.contains("\nMESM:CLASSIC;^\n"));
    emulator.power_cycle();
    assert_eq!(ask(&mut link, "L0").await, "L0\n0\n\n");
}

#[tokio::test(start_paused = true)]
async fn a_ust_says_what_it_is() {
    let mut link = sensor(Model::Ust10lx).build().link();
    for (command, reply) in [
        (
            "II",
            "MODL:UST-10LX;D\nLASR:OFF;7\nSCSP:2400;i\nMESM:Measuring by Sensitive Mode;A\n\
             SBPS:Ethernet 100[Mbps];\\\nTIME:0000;Y\nSTAT:sensor is working normally;k",
        ),
        (
            "VV",
            "VEND:Hokuyo Automatic Co., Ltd.;;\nPROD:UST-10LX;M\nFIRM:4.1.0;I\nPROT:SCIP 2.2;P\n\
             SERI:H0000001;6",
        ),
        (
            "PP",
            // Hokuyo's UrgBenri takes only eight lines.
            "MODL:UST-10LX;D\nDMIN:20;4\nDMAX:30000;G\nARES:1440;^\nAMIN:0;?\nAMAX:1080;Z\n\
             AFRT:540;0\nSCAN:2400;U",
        ),
    ] {
        assert_eq!(ask(&mut link, command).await, format!("{command}\n00P\n{reply}\n\n"));
    }
}

#[tokio::test(start_paused = true)]
async fn a_utm_says_what_it_is() {
    let emulator = sensor(Model::Utm30lx).build();
    let mut link = emulator.link();
    for (command, reply) in [
        (
            "II",
            "MODL:UTM-30LX(Hokuyo Automatic Co.,Ltd.);U\nLASR:OFF;7\n\
             SCSP:Initial(2400[rpm])<-Default setting by user;1\nMESM:IDLE;:\nSBPS:USB only;n\n\
             TIME:000000;9\nSTAT:Sensor works well.;8",
        ),
        (
            "VV",
            "VEND:Hokuyo Automatic Co.,Ltd.;[\nPROD:SOKUIKI Sensor UTM-30LX;b\nFIRM:P.1.05;Z\n\
             PROT:SCIP 2.0;N\nSERI:H0000001;6",
        ),
        (
            "PP",
            "MODL:UTM-30LX(Hokuyo Automatic Co.,Ltd.);U\nDMIN:23;7\nDMAX:60000;J\nARES:1440;^\n\
             AMIN:0;?\nAMAX:1080;Z\nAFRT:540;0\nSCAN:2400;U",
        ),
    ] {
        assert_eq!(ask(&mut link, command).await, format!("{command}\n00P\n{reply}\n\n"));
    }
    assert_eq!(emulator.baud_rate(), None);
}

/// What real ones sent, except for the serial number.
#[tokio::test(start_paused = true)]
async fn a_ug01_says_what_it_is() {
    let mut link = sensor(Model::Urg04lxUg01).laser(true).build().link();
    let version = "VV\n00P\nVEND:Hokuyo Automatic Co.,Ltd.;[\n\
        PROD:SOKUIKI Sensor URG-04LX-UG01(Simple-URG);[\nFIRM:3.4.03(17/Dec./2012);T\n\
        PROT:SCIP 2.0;N\nSERI:H0000001;6\n\n";
    assert_eq!(ask(&mut link, "VV").await, version);
    let parameters = ask(&mut link, "PP").await;
    let model = "MODL:URG-04LX-UG01(Simple-URG)(Hokuyo Automatic Co.,Ltd.);";
    assert!(parameters.contains(model), "{parameters}");
    let state = ask(&mut link, "II").await;
    assert!(state.contains("MESM:Measuring by Normal Mode;"), "{state}");
    assert!(state.contains("SBPS:19200[bps]<-Default setting by user;A"), "{state}");
}

/// Status of a command that a model does not know: `0F` of a UST, `0E` of the others.
const UNKNOWN: &str = "unknown";

#[tokio::test(start_paused = true)]
async fn each_model_answers_with_its_status() {
    use Model::{Urg04lx as Urg, Urg04lxUg01 as Ug01, Ust10lx as Ust, Utm30lx as Utm};
    for (models, command, status) in [
        (&[Urg, Ug01, Utm, Ust][..], "BM", "00P"),
        (&[Urg, Ug01, Utm, Ust], "QT", "00P"),
        (&[Urg, Ug01, Utm, Ust], "RS", "00P"),
        (&[Urg, Ug01, Utm, Ust], "RT", "00P"),
        (&[Urg, Ug01, Utm, Ust], "RB", "01Q"),
        (&[Urg, Ug01, Utm, Ust], "TM2", "03S"),
        (&[Urg, Ug01, Utm, Ust], "TM3", "01Q"),
        (&[Urg, Ug01, Utm, Ust], "GD0044072501", "10Q"),
        // Not known, too short, too long.
        (&[Urg, Ug01, Utm, Ust], "V", UNKNOWN),
        (&[Urg, Ug01, Utm, Ust], "L1", UNKNOWN),
        (&[Urg, Ug01, Utm, Ust], "XY", UNKNOWN),
        (&[Urg, Ug01, Utm, Ust], "SCIP2.0", UNKNOWN),
        (&[Urg, Ug01, Utm, Ust], "VV1", "0Dd"),
        (&[Urg, Ug01, Utm, Ust], "TM", "0Cc"),
        (&[Urg, Ug01, Utm], "GD004407250", "0Cc"),
        (&[Urg, Ug01, Utm, Ust], "MD004407250100", "0Cc"),
        (&[Urg, Ug01, Utm, Ust], "MD00440725010000", "0Dd"),
        // Texts of the host.
        (&[Urg, Ug01, Utm, Ust], "QT;host 1._+@ 4567", "00P"),
        (&[Urg, Ug01, Utm, Ust], "QT;", "00P"),
        (&[Urg, Ug01, Utm, Ust], "QT;12345678901234567", "0Gg"),
        (&[Urg, Ug01, Utm, Ust], "QT;a;b", "0Hh"),
        (&[Urg, Ug01, Utm, Ust], "QT;a-b", "0Hh"),
        // Steps, clusters, skips and counts.
        (&[Urg, Ug01, Utm], "GDx044072501", "01Q"),
        (&[Urg, Ug01, Utm], "GD004407+501", "02R"),
        (&[Urg, Ug01, Utm], "GD00440725 1", "03S"),
        (&[Urg, Ug01], "GD0044076901", "04T"),
        (&[Utm], "GD0044108101", "04T"),
        (&[Urg, Ug01, Utm, Ust], "MD0100009901000", "05U"),
        (&[Urg, Ug01, Utm, Ust], "MD0044072501x00", "06V"),
        (&[Urg, Ug01, Utm], "MS00440725010-1", "07W"),
        (&[Urg, Ug01, Utm], "GS0044072501", "10Q"),
        (&[Ust], "GS0044072501", UNKNOWN),
        (&[Ust], "MS0044072501000", UNKNOWN),
        // Baud rates and speeds.
        (&[Urg], "SS115200", "00P"),
        (&[Urg], "SS038400", "04T"),
        (&[Urg], "SS01920x", "01Q"),
        (&[Urg], "SS012345", "02R"),
        (&[Ug01, Utm], "SS115200", "04T"),
        (&[Ust], "SS115200", "0Ff"),
        (&[Urg, Ug01], "CR00", "03S"),
        (&[Urg, Ug01], "CR99", "03S"),
        (&[Urg, Ug01], "CR05", "00P"),
        (&[Urg, Ug01], "CR11", "02R"),
        (&[Urg, Ug01], "CR1x", "01Q"),
        (&[Utm, Ust], "CR05", "04T"),
        (&[Urg], "HS1", "0Cc"),
        (&[Ug01], "HS1", "00P"),
        (&[Ug01], "HS2", "01Q"),
        (&[Utm, Ust], "HS1", UNKNOWN),
        // Intensities, several echoes, states and microseconds.
        (&[Ug01], "GE0044072501", UNKNOWN),
        (&[Utm, Ust], "GE0044072501", "10Q"),
        (&[Ug01, Utm, Ust], "HD0044072501", UNKNOWN),
        (&[Ug01, Utm, Ust], "HE0044072501", UNKNOWN),
        (&[Ug01, Utm, Ust], "ND0044072501000", UNKNOWN),
        (&[Ug01, Utm, Ust], "NE0044072501000", UNKNOWN),
        (&[Urg, Ug01, Utm], "%ST", UNKNOWN),
        (&[Urg, Ug01, Utm], "%SL", UNKNOWN),
        (&[Urg, Ug01, Utm], "%TM1", UNKNOWN),
        (&[Urg, Ug01, Utm], "%MD0044072501000", UNKNOWN),
        (&[Urg, Ug01, Utm], "%ME0044072501000", UNKNOWN),
        (&[Ust], "%TM0", "01Q"),
        (&[Ust], "%SL", "00P"),
    ] {
        for model in models {
            let mut link = sensor(*model).build().link();
            let reply = ask(&mut link, command).await;
            let status = match (status, model) {
                (UNKNOWN, Ust) => "0Ff",
                (UNKNOWN, _) => "0Ee",
                _ => status,
            };
            assert_eq!(reply, format!("{command}\n{status}\n\n"), "{model:?}");
        }
    }
}

/// As one with firmware 2.23.0000 answered: `GD` without digits only tells that the laser is off.
#[tokio::test(start_paused = true)]
async fn a_ust_looks_at_its_laser_before_the_digits() {
    for (command, off, on) in [
        ("GD", "10Q", "0Cc"),
        ("GE", "10Q", "0Cc"),
        ("MD", "0Cc", "0Cc"),
        ("ME", "0Cc", "0Cc"),
        ("GDx044072501", "10Q", "01Q"),
        ("GD004407+501", "10Q", "02R"),
        ("GD00440725 1", "10Q", "03S"),
        ("GD0044108101", "10Q", "04T"),
        ("GD00440725010", "10Q", "0Dd"),
        ("GS", "0Ff", "0Ff"),
        ("GD;a-b", "0Hh", "0Hh"),
    ] {
        for (is_on, status) in [(false, off), (true, on)] {
            let mut link = sensor(Model::Ust10lx).laser(is_on).build().link();
            assert_eq!(ask(&mut link, command).await, format!("{command}\n{status}\n\n"));
        }
    }
    let emulator = sensor(Model::Ust10lx).build();
    assert_eq!(ask(&mut emulator.link(), "GD0044072501").await, "GD0044072501\n10Q\n\n");
    assert_eq!(emulator.log()[0].verdict, Verdict::WellFormed);
}

/// As a UST-10LX sent to a host that ends its commands with CR, and as hosts read it that send both.
#[tokio::test(start_paused = true)]
async fn the_echo_of_a_ust_ends_as_the_command_did() {
    for (model, ends) in [(Model::Ust10lx, ["\n", "\r", "\n"]), (Model::Utm30lx, ["\n"; 3])] {
        for (command, end) in ["BM\n", "BM\r", "BM\r\n"].into_iter().zip(ends) {
            let mut link = sensor(model).build().link();
            link.write_all(command.as_bytes()).await.unwrap();
            assert_eq!(listen(&mut link).await, format!("BM{end}00P\n\n"), "{model:?} {command:?}");
        }
    }
}

#[tokio::test(start_paused = true)]
async fn distances_have_two_or_three_characters_and_intensities_three() {
    let world = Fixed::new([1234, 70_000, 19, 1, 65_533, 300, 5432]);
    for (model, command, data) in [
        (Model::Ust10lx, "GD0000000001", "0CBe"),
        (Model::Ust10lx, "GD0006000601", "1DhM"),
        (Model::Ust10lx, "GD0000000301", "0CBA5`00C001o"),
        // 70,000 mm do not fit.
        (Model::Utm30lx, "GS0000000301", "CBoo0C01g"),
        (Model::Ust10lx, "GE0000000101", "0CB0=oA5`05b^"),
        // What is no distance has no intensity.
        (Model::Ust10lx, "GE0004000401", "?om000["),
        (Model::Utm30lx, "GE0003000301", "001000Q"),
        (Model::Urg04lx, "GS0000000001", "CB5"),
        // The least distance; a code only where there is no distance.
        (Model::Ust10lx, "GD0000000504", "0CB04\\e"),
        (Model::Ust10lx, "GD0002000403", "001A"),
        (Model::Utm30lx, "GD0002000503", "00104\\A"),
        (Model::Urg04lx, "GD0000000300", "0CBA5`00C001o"),
    ] {
        let mut link = sensor(model).world(world.clone()).laser(true).build().link();
        sleep(Duration::from_secs(1)).await;
        let reply = ask(&mut link, command).await;
        let (_, found) = reply.trim_end().rsplit_once('\n').unwrap();
        assert_eq!(found, data, "{model:?} {command}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_scan_has_the_time_of_its_first_step() {
    let mut link = sensor(Model::Ust10lx).laser(true).build().link();
    sleep(Duration::from_secs(1)).await;
    // Step 0 was measured 1,081 steps of 1,440 before the end of the revolution, after 981.2 ms.
    let reply = "GD0100010001;a b\n00P\n00?ET\n0CBe\n\n";
    assert_eq!(ask(&mut link, "GD0100010001;a b").await, reply);
}

#[tokio::test(start_paused = true)]
async fn no_scan_is_of_a_time_when_the_laser_was_off() {
    for model in [Model::Utm30lx, Model::Ust10lx] {
        let mut link = sensor(model).build().link();
        sleep(Duration::from_millis(1010)).await;
        assert_eq!(ask(&mut link, "BM").await, "BM\n00P\n\n");
        let asked = Instant::now();
        // Of the revolution that begins after 1,025 ms, and ends after 1,050 ms: it is sent at its end, with
        // the time of its first step, 18.8 ms before.
        let reply = ask(&mut link, "GD0000000001").await;
        assert_eq!(reply, "GD0000000001\n00P\n00@7G\n0CBe\n\n", "{model:?}");
        assert!(asked.elapsed() >= Duration::from_millis(38), "{model:?}");
    }
}

#[tokio::test(start_paused = true)]
async fn lines_have_64_characters_and_a_sum() {
    let mut link = sensor(Model::Utm30lx).laser(true).build().link();
    sleep(Duration::from_secs(1)).await;
    let reply = ask(&mut link, "GD0000108001").await;
    assert_eq!(reply.len(), "GD0000108001\n00P\n".len() + 6 + 3243 + 2 * 51 + 1);
    let lines: Vec<&str> = reply.lines().collect();
    // "0CB" 21 times and "0": 21 * 0xB5 + 0x30 = 0xF09.
    assert_eq!(lines[3], format!("{}09", "0CB".repeat(21)));
    // A value runs over the end of a line.
    assert_eq!(lines[4], format!("CB{}0CL", "0CB".repeat(20)));
}

#[tokio::test(start_paused = true)]
async fn the_same_kind_twice_is_an_error() {
    let mut link = sensor(Model::Urg04lx).pace(urg_emulator::Pace::PerRevolution).build().link();
    link.write_all(b"TM1;a\nBM;b\nTM1;c\nQT;d\n").await.unwrap();
    assert!(listen(&mut link).await.starts_with("TM1;a\n00P\n"));
    assert_eq!(listen(&mut link).await, "BM;b\n00P\n\n");
    assert_eq!(listen(&mut link).await, "TM1;c\n0Bb\n\n");
    assert_eq!(listen(&mut link).await, "QT;d\n00P\n\n");
    // Once answered, it may be sent again.
    assert!(ask(&mut link, "TM1;a").await.starts_with("TM1;a\n00P\n"));
}

#[tokio::test(start_paused = true)]
async fn intensities_lock_a_urg_04lx() {
    for command in ["GE0044072501", "ME0044072501000", "HD0044072501", "NE0044072501000"] {
        let emulator = sensor(Model::Urg04lx).build();
        let mut link = emulator.link();
        assert_eq!(ask(&mut link, command).await, "");
        assert_eq!(ask(&mut link, "QT").await, "");
        emulator.power_cycle();
        assert_eq!(ask(&mut link, "L1").await, "L1\n0\n\n");
    }
}

#[tokio::test(start_paused = true)]
async fn the_baud_rate_changes_on_rs_232() {
    let emulator = sensor(Model::Urg04lx).baud_rate(BaudRate::B19200).stray_byte(false).build();
    let mut link = emulator.link();
    assert_eq!(ask(&mut link, "SS019200").await, "SS019200\n03S\n\n");
    assert_eq!(ask(&mut link, "SS115200").await, "SS115200\n00P\n\n");
    sleep(Duration::from_millis(200)).await;
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B115200));
    link.set_baud_rate(BaudRate::B115200).unwrap();
    assert_eq!(ask(&mut link, "RT").await, "RT\n00P\n\n");
    assert_eq!(ask(&mut link, "RS").await, "RS\n00P\n\n");
    sleep(Duration::from_millis(200)).await;
    assert_eq!(emulator.baud_rate(), Some(BaudRate::B19200));
}

#[tokio::test(start_paused = true)]
async fn quirks_change_sums() {
    let mut link = sensor(Model::Urg04lx).quirk(Quirk::SerialSumApart).build().link();
    assert!(ask(&mut link, "VV").await.ends_with("\nPROT:SCIP 2.0;N\nSERI:H0000001;7\n6\n\n"));
    let mut link = sensor(Model::Utm30lx).quirk(Quirk::ShortStateSums).build().link();
    let state = ask(&mut link, "II").await;
    assert!(state.contains("\nSCSP:Initial(2400[rpm])<-Default setting by user;K\n"), "{state}");
}

#[tokio::test(start_paused = true)]
async fn verdicts_are_those_of_the_protocols_known() {
    for (emulator, expected) in [
        (Emulator::builder().build(), [true, false, false]),
        (Emulator::builder().firmware(Firmware::V31).build(), [true, true, true]),
        (sensor(Model::Ust10lx).build(), [false, true, false]),
    ] {
        let mut link = emulator.link();
        for command in ["L1", "PP", "SCIP2.0"] {
            ask(&mut link, command).await;
        }
        let found: Vec<bool> =
            emulator.log().iter().map(|line| line.verdict == Verdict::WellFormed).collect();
        assert_eq!(found, expected);
    }
}
