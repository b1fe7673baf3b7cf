//! The scripted sensor in SCIP 2: its answers, and the scans that it sends unasked. It measures steps 0
//! to 400, and may tell any geometry besides.

use std::time::Duration;

use tokio::time::Instant;

use super::peer::{PeerState, code};

/// Period of the scans, in milliseconds.
const PERIOD: u64 = 25;

/// Scans that are sent until `QT`.
pub(crate) struct ScriptedStream {
    /// When the next one is sent.
    pub(super) next: Instant,
    echo: Vec<u8>,
}

/// A text with its sum (p. 9).
fn summed(text: &[u8]) -> Vec<u8> {
    let total: u64 = text.iter().map(|&byte| u64::from(byte)).sum();
    [text, &[b'0' + (total % 64) as u8]].concat()
}

fn encode(number: u64, characters: u32) -> impl Iterator<Item = u8> {
    (0..characters).rev().map(move |at| b'0' + (number >> (6 * at)) as u8 % 64)
}

impl PeerState {
    pub(super) fn answer_scip2(&mut self, line: &[u8]) {
        let command = line.split(|&byte| byte == b';').next().unwrap_or_default();
        let answer = match command {
            b"" => return,
            b"VV" => lines(&["00", "VEND:x", "PROD:x", "FIRM:1", "PROT:2", "SERI:H1"]),
            b"PP" => self.parameters(),
            b"BM" if self.laser => lines(&["02"]),
            b"BM" => {
                self.laser = true;
                lines(&["00"])
            }
            b"QT" => {
                (self.laser, self.stream) = (false, None);
                lines(&["00"])
            }
            [b'G', b'D', steps @ ..] if steps.len() == 10 => self.latest(steps),
            [b'M', b'D', steps @ ..] if steps.len() == 13 => {
                let next = Instant::now() + Duration::from_millis(PERIOD);
                self.polls += 1;
                self.laser = true;
                self.stream = Some(ScriptedStream { next, echo: line.to_vec() });
                lines(&["00"])
            }
            _ => lines(&["0E"]),
        };
        self.deliver(&frame(line, &answer), false);
    }

    fn latest(&mut self, steps: &[u8]) -> Vec<Vec<u8>> {
        if !self.laser {
            return lines(&["10"]);
        }
        self.polls += u64::from(steps[..4] != steps[4..8]);
        self.scan(b"00", steps)
    }

    /// Puts the scans of the stream that are due on their way.
    pub(super) fn send_streamed(&mut self, now: Instant) {
        while let Some(stream) = &mut self.stream
            && stream.next <= now
        {
            let echo = stream.echo.clone();
            stream.next = now + Duration::from_millis(PERIOD);
            let answer = match self.next() {
                // A status in place of a scan.
                decision @ 0xfc.. => vec![vec![b'0' + decision % 4, b'1' + self.next() % 9]],
                _ => self.scan(b"99", &echo[2..]),
            };
            self.deliver(&frame(&echo, &answer), false);
        }
    }

    /// Lines of a scan: status, clock and data.
    fn scan(&mut self, status: &[u8], steps: &[u8]) -> Vec<Vec<u8>> {
        let step = |text: &[u8]| std::str::from_utf8(text).unwrap().parse::<u64>().unwrap();
        let request = self.scans.len() as u64;
        // Two revolutions have different clocks, whatever the time.
        let clock = encode((request + 1) * PERIOD, 4).collect();
        let data: Vec<u8> = (step(&steps[..4])..=step(&steps[4..8]))
            .flat_map(|step| encode(code(request, step).into(), 3))
            .collect();
        self.scans.push(Instant::now());
        [status.to_vec(), clock].into_iter().chain(data.chunks(64).map(<[u8]>::to_vec)).collect()
    }

    /// What it measures: any numbers, but for the steps.
    fn parameters(&mut self) -> Vec<Vec<u8>> {
        let mut number = |usual: u64| match self.next() {
            0..0xc0 => usual,
            digits => usual * u64::from(digits % 16) + u64::from(self.next()),
        };
        let [least, most, turn] = [20, 5600, 1440].map(&mut number);
        let [front, speed] = [200, 2400].map(number);
        let texts = [
            format!("DMIN:{least}"),
            format!("DMAX:{most}"),
            format!("ARES:{turn}"),
            "AMIN:0".to_owned(),
            "AMAX:400".to_owned(),
            format!("AFRT:{front}"),
            format!("SCAN:{speed}"),
        ];
        [b"00".to_vec()].into_iter().chain(texts.map(String::into_bytes)).collect()
    }
}

fn lines(texts: &[&str]) -> Vec<Vec<u8>> {
    texts.iter().map(|text| text.as_bytes().to_vec()).collect()
}

/// A reply: echo, and lines with their sums. A `;` separates a text from its sum, and is not summed.
fn frame(echo: &[u8], lines: &[Vec<u8>]) -> Vec<u8> {
    let mut frame = echo.to_vec();
    for line in lines {
        let mut line = summed(line);
        if line.contains(&b':') && line.len() > 5 && line[4] == b':' {
            line.insert(line.len() - 1, b';');
        }
        frame.push(b'\n');
        frame.extend(line);
    }
    frame.extend(b"\n\n");
    frame
}
