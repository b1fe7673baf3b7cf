//! What each model says about itself: `VV`, `PP` and `II`.

use crate::body::Body;
use crate::models::Model;

/// Lines of the reply to `VV`.
pub(super) fn version(body: &Body) -> Vec<Vec<u8>> {
    if let Some(lines) = &body.version_lines {
        return lines.clone();
    }
    let (vendor, product, firmware, protocol) = match body.model {
        Model::Urg04lx => {
            ("Co.,Ltd.", "SOKUIKI Sensor URG-04LX", "3.1.04(02/Aug./2007)", "SCIP 2.0")
        }
        Model::Urg04lxUg01 => (
            "Co.,Ltd.",
            "SOKUIKI Sensor URG-04LX-UG01(Simple-URG)",
            "3.4.03(17/Dec./2012)",
            "SCIP 2.0",
        ),
        Model::Utm30lx => ("Co.,Ltd.", "SOKUIKI Sensor UTM-30LX", "P.1.05", "SCIP 2.0"),
        Model::Ust10lx => ("Co., Ltd.", "UST-10LX", "4.1.0", "SCIP 2.2"),
    };
    [
        format!("VEND:Hokuyo Automatic {vendor}"),
        format!("PROD:{product}"),
        format!("FIRM:{firmware}"),
        format!("PROT:{protocol}"),
        format!("SERI:{}", body.serial_number),
    ]
    .map(String::into_bytes)
    .into()
}

fn model(model: Model) -> &'static str {
    match model {
        Model::Urg04lx => "MODL:URG-04LX(Hokuyo Automatic Co.,Ltd.)",
        Model::Urg04lxUg01 => "MODL:URG-04LX-UG01(Simple-URG)(Hokuyo Automatic Co.,Ltd.)",
        Model::Utm30lx => "MODL:UTM-30LX(Hokuyo Automatic Co.,Ltd.)",
        Model::Ust10lx => "MODL:UST-10LX",
    }
}

/// Lines of the reply to `PP`.
pub(super) fn parameters(body: &Body) -> Vec<Vec<u8>> {
    if let Some(lines) = body.parameter_lines() {
        return lines;
    }
    let geometry = body.geometry(true);
    let lines = [
        model(body.model).to_owned(),
        format!("DMIN:{}", geometry.nearest),
        format!("DMAX:{}", geometry.farthest),
        format!("ARES:{}", geometry.resolution),
        format!("AMIN:{}", geometry.first),
        format!("AMAX:{}", geometry.last),
        format!("AFRT:{}", geometry.front),
        format!("SCAN:{}", rpm(body.model)),
    ];
    lines.map(String::into_bytes).into()
}

/// Lines of the reply to `II`. The time is in milliseconds, and in characters.
pub(super) fn state(body: &Body, milliseconds: u64, characters: [u8; 4]) -> Vec<Vec<u8>> {
    let rpm = rpm(body.model);
    let by_user = "<-Default setting by user";
    let (speed, line, time, works) = if body.model == Model::Ust10lx {
        let line = "Ethernet 100[Mbps]".to_owned();
        (rpm.to_string(), line, characters.to_vec(), "sensor is working normally")
    } else {
        let line = match (body.model, body.baud_rate) {
            (Model::Utm30lx, _) => "USB only".to_owned(),
            (_, rate) => format!("{}[bps]{by_user}", rate.map_or(19_200, u32::from)),
        };
        let time = format!("{milliseconds:06X}").into_bytes();
        (format!("Initial({rpm}[rpm]){by_user}"), line, time, "Sensor works well.")
    };
    let measuring = match body.model {
        Model::Ust10lx => "Measuring by Sensitive Mode",
        // Seen on a URG-04LX-UG01 and a URG-04LX.
        Model::Urg04lxUg01 if body.is_laser_on => "Measuring by Normal Mode",
        _ if body.is_laser_on => "CLASSIC",
        _ => "IDLE",
    };
    let laser = if body.is_laser_on { "ON" } else { "OFF" };
    let texts = [
        ("LASR:", laser.as_bytes()),
        ("SCSP:", speed.as_bytes()),
        ("MESM:", measuring.as_bytes()),
        ("SBPS:", line.as_bytes()),
        ("TIME:", &time),
        ("STAT:", works.as_bytes()),
    ];
    let texts = texts.map(|(key, value)| [key.as_bytes(), value].concat());
    std::iter::once(model(body.model).as_bytes().to_vec()).chain(texts).collect()
}

/// Nominal speed of the motor.
fn rpm(model: Model) -> u128 {
    60_000 / model.revolution().as_millis()
}
