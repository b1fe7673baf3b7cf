//! [`Chooser`]: one sequence of choices after the other, depth first, until each was
//! made once. A run asks it wherever more than one thing can happen, and is started
//! again from the beginning for the next sequence.

/// Choices of a run.
#[derive(Debug, Default)]
pub(crate) struct Chooser {
    /// Each choice, and the number of its alternatives.
    path: Vec<(usize, usize)>,
    /// Number of choices that this run has made.
    made: usize,
}

impl Chooser {
    /// Returns a chooser whose first run makes these choices.
    pub(crate) fn starting_with(choices: &[usize]) -> Self {
        Self { path: choices.iter().map(|choice| (*choice, choice + 1)).collect(), made: 0 }
    }

    /// Returns one of `0..alternatives`: 0 in the first run.
    pub(crate) fn choose(&mut self, alternatives: usize) -> usize {
        if self.made == self.path.len() {
            self.path.push((0, alternatives));
        }
        let (choice, _) = self.path[self.made];
        self.made += 1;
        choice
    }

    /// Goes on to the next sequence. Returns false after the last one.
    pub(crate) fn advance(&mut self) -> bool {
        self.path.truncate(self.made);
        self.made = 0;
        while let Some((choice, alternatives)) = self.path.last_mut() {
            *choice += 1;
            if choice < alternatives {
                return true;
            }
            self.path.pop();
        }
        false
    }

    /// Returns the choices that this run has made.
    pub(crate) fn choices(&self) -> Vec<usize> {
        self.path.iter().take(self.made).map(|(choice, _)| *choice).collect()
    }
}

#[test]
fn every_sequence_of_choices_is_made_once() {
    let (mut chooser, mut seen) = (Chooser::default(), Vec::new());
    loop {
        // The second choice has as many alternatives as the first one selects.
        let first = chooser.choose(3);
        let second = if first > 0 { chooser.choose(first + 1) } else { 9 };
        seen.push((first, second));
        if !chooser.advance() {
            break;
        }
    }
    assert_eq!(seen, [(0, 9), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)]);
}
