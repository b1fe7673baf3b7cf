//! [`Codes`]: which values are no distance.

/// Values that stand for "no distance", which depend on the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) enum Codes {
    /// 0 to 19: every sensor in SCIP 1.1 (C-42-3320-A p. 7).
    Scip1,
    /// 0 to 19: URG, UBG and UHG in SCIP 2 (p. 12).
    Urg,
    /// 1 to 5: UTM on USB (p. 12).
    Utm,
    /// 4 and 65533: UST (C-42-04213 p. 4). UTM on Ethernet (`-EW`) was seen to send 65533.
    Ethernet,
    /// 65532 to 65535: UAM (Hokuyo's package uam-05lp 0.2.0, of their other protocol).
    Uam,
    /// None that are known.
    Unknown,
}

impl Codes {
    /// Returns the codes of a model in SCIP 2 by its name, as in [`Parameters::model`](super::scip2::Parameters).
    pub(super) fn of(model: &[u8]) -> Self {
        match model {
            [b'U', b'R' | b'B' | b'H', b'G', ..] => Self::Urg,
            [b'U', b'T', b'M', b'-', rest @ ..] if !rest.windows(3).any(|part| part == b"-EW") => {
                Self::Utm
            }
            [b'U', b'T', b'M', b'-', ..] | [b'U', b'S', b'T', ..] => Self::Ethernet,
            [b'U', b'A', b'M', ..] => Self::Uam,
            _ => Self::Unknown,
        }
    }

    /// Returns why `value` is no distance, in SCIP 1.1 in the words of the protocol text, or `None` if
    /// it is one. It may still be outside of [`Geometry::distances`](super::Geometry::distances).
    pub(super) const fn meaning(self, value: u32) -> Option<&'static str> {
        Some(match (self, value) {
            (Self::Scip1, 0) => "Possibility of detected object is at 22m",
            (Self::Scip1, 1..=5) => "Reflected light has low intensity",
            (Self::Scip1, 6) => "Possibility of detected object is at 5.7m",
            (Self::Scip1, 7) => "Distance data on the preceding and succeeding steps have errors",
            (Self::Scip1, 9) => "The same step had error in the last two scan",
            (Self::Scip1, 16) => "Possibility of detected object is in the range 4096mm~5.6m",
            (Self::Scip1, 18) => "Unspecified",
            (Self::Scip1, 19) => "Non-Measurable Distance",
            (Self::Scip1, 0..20) => "Others",
            (Self::Urg, 0) => "an object may be at 22 m",
            (Self::Urg, 1 | 2) => "little light returned",
            (Self::Urg, 7) => "the steps before and after have errors",
            (Self::Urg, 8) => "the intensities of two waves differ",
            (Self::Urg, 9) => "the same step had an error in the last two scans",
            (Self::Urg, 18) => "strong reflector",
            (Self::Urg, 19) => "step that is not measured",
            (Self::Urg, 3..=17) => "other error",
            (Self::Utm, 1) | (Self::Ethernet, 65_533) | (Self::Uam, 65_534) => "nothing in range",
            (Self::Utm, 2) | (Self::Uam, 65_533) => "object too near",
            (Self::Utm, 3) => "interference",
            (Self::Utm | Self::Ethernet, 4) => "object before the near end of the range",
            (Self::Uam, 65_532) => "the laser is off",
            (Self::Utm, 5) | (Self::Uam, 65_535) => "other error",
            _ => return None,
        })
    }
}
