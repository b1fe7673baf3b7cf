//! Commands to a playback, from a key or over HTTP.

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum PlaybackCommand {
    Play,
    Pause,
    /// Pauses or plays. At the end, plays again from the start.
    Toggle,
    /// Pauses and moves by a number of scans, backwards if it is negative.
    Step(isize),
    /// Jumps to a scan, counted from 0.
    Scan(usize),
    /// Jumps to a time, in seconds since the first scan.
    Seek(f64),
    /// Moves by a number of seconds, backwards if it is negative.
    SeekBy(f64),
    Speed(f64),
    Loop(bool),
}

impl std::str::FromStr for PlaybackCommand {
    type Err = &'static str;

    /// Parses a query of `/playback`, such as `pause` or `seek=12.5`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const EXPECTED: &str = "expected one of play, pause, toggle, step=N, scan=N, \
                                seek=SECONDS, by=SECONDS, speed=0.1 to 100, loop=true or false";
        let (name, value) = text.split_once('=').unwrap_or((text, ""));
        let seconds = || value.parse().ok().filter(|seconds: &f64| seconds.is_finite());
        let command = match (name, value) {
            ("play", "") => Some(Self::Play),
            ("pause", "") => Some(Self::Pause),
            ("toggle", "") => Some(Self::Toggle),
            ("step", count) => count.parse().ok().map(Self::Step),
            ("scan", number) => number.parse().ok().map(Self::Scan),
            ("seek", _) => seconds().map(Self::Seek),
            ("by", _) => seconds().map(Self::SeekBy),
            ("speed", _) => {
                seconds().filter(|speed| super::settings::SPEEDS.contains(speed)).map(Self::Speed)
            }
            ("loop", value) => value.parse().ok().map(Self::Loop),
            _ => None,
        };
        command.ok_or(EXPECTED)
    }
}
