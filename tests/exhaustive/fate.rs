//! [`Fate`]: the possible outcomes of a command and its reply.

/// Outcome of an exchange.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fate {
    OnTime,
    /// The reply comes just before its deadline, after the time of several polls.
    Late,
    /// The reply comes at its very deadline.
    AtDeadline,
    /// The reply comes after the next command, before the reply to that.
    AfterNext,
    /// The reply comes after the next command but one.
    AfterSecond,
    Lost,
    /// The first half of the reply comes, and no end.
    Cut,
    /// A byte before the end is one that no reply has.
    Damaged,
    /// The last of the two LFs is lost: the reply runs into the next one.
    Merged,
    /// A second copy comes in the same read.
    Doubled,
    /// A second copy comes before the next command of a grid.
    DoubledSoon,
    /// A second copy comes after the next command, before the reply to that.
    DoubledAfterNext,
    /// The command does not reach the sensor.
    CommandLost,
    /// A bit before the end is flipped.
    Flipped,
    /// The sensor refuses a command, or sends no scan while it checks itself.
    Refused,
    /// The sensor answers, and does not obey.
    Ignored,
}

/// Every fate, the good one first.
pub(crate) const FATES: &[Fate] = &[
    Fate::OnTime,
    Fate::Late,
    Fate::AtDeadline,
    Fate::AfterNext,
    Fate::AfterSecond,
    Fate::Lost,
    Fate::Cut,
    Fate::Damaged,
    Fate::Merged,
    Fate::Doubled,
    Fate::CommandLost,
    Fate::DoubledSoon,
    Fate::DoubledAfterNext,
];

/// Every fate in SCIP 2.
pub(crate) const SCIP2_FATES: &[Fate] = &{
    let mut fates = [Fate::Flipped; FATES.len() + 3];
    fates.split_at_mut(FATES.len()).0.copy_from_slice(FATES);
    fates[FATES.len()] = Fate::Refused;
    fates[FATES.len() + 1] = Fate::Ignored;
    fates
};

impl Fate {
    /// Returns it in words, for a drawing.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::OnTime => "on time",
            Self::Late => "reply just before its deadline",
            Self::AtDeadline => "reply at its deadline",
            Self::AfterNext => "reply after the next command",
            Self::AfterSecond => "reply after the next command but one",
            Self::Lost => "reply lost",
            Self::Cut => "reply cut off",
            Self::Damaged => "reply damaged",
            Self::Merged => "reply runs into the next one",
            Self::Doubled => "reply doubled",
            Self::DoubledSoon => "reply doubled, the copy a moment later",
            Self::DoubledAfterNext => "reply doubled, the copy after the next command",
            Self::CommandLost => "command lost",
            Self::Flipped => "a bit of the reply flipped",
            Self::Refused => "refused",
            Self::Ignored => "command answered and ignored",
        }
    }
}
