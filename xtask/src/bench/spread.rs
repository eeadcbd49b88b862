//! The long run: how far the instructions of a tick lie apart over many different samples.

use anyhow::{Context as _, Result, ensure};

/// Ticks of the long run.
pub(crate) const TICKS: u32 = 100_000;

/// How far a tick may be from the mean, in thousandths of it: jitter of the tick is jitter of the torque.
pub(crate) const PERMILLE_LIMIT: u64 = 50;

/// Instructions of one row over many ticks.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Spread {
    pub(crate) row: String,
    pub(crate) ticks: u32,
    pub(crate) least: u32,
    pub(crate) mean: f64,
    pub(crate) most: u32,
}

impl Spread {
    /// From the line `name least sum most` over `ticks` ticks.
    pub(crate) fn read(line: &str, ticks: u32) -> Result<Self> {
        let words: Vec<_> = line.split(' ').collect();
        let [row, least, sum, most] = words[..] else {
            anyhow::bail!("the bench program said `{line}` of its long run");
        };
        let number = |word: &str| {
            word.parse::<u64>()
                .with_context(|| format!("`{word}` is no count in `{line}`"))
        };
        let spread = Self {
            row: row.to_owned(),
            ticks,
            least: u32::try_from(number(least)?)?,
            mean: number(sum)? as f64 / f64::from(ticks),
            most: u32::try_from(number(most)?)?,
        };
        let between =
            f64::from(spread.least) <= spread.mean && spread.mean <= f64::from(spread.most);
        ensure!(between, "the long run cannot be trusted: `{line}`");
        Ok(spread)
    }

    /// The same without the `bracket` that every call was counted with.
    pub(crate) fn without(self, bracket: u32) -> Self {
        Self {
            least: self.least.saturating_sub(bracket),
            mean: self.mean - f64::from(bracket),
            most: self.most.saturating_sub(bracket),
            ..self
        }
    }

    /// Largest distance from the mean, as a fraction of it.
    pub(crate) fn deviation(&self) -> f64 {
        (f64::from(self.most) - self.mean).max(self.mean - f64::from(self.least)) / self.mean
    }

    /// The same in thousandths, rounded up.
    pub(crate) fn permille(&self) -> u64 {
        (1000.0 * self.deviation()).ceil() as u64
    }

    pub(crate) fn quantity(&self) -> String {
        format!("{}, permille off its mean", self.row)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_the_larger_distance_from_the_mean() {
        let spread = Spread::read("step 990 10100 1060", 10).unwrap();
        assert_eq!(spread.permille(), 50);
        assert_eq!(spread.without(10).mean, 1000.0);
        assert_eq!(
            Spread::read("step 900 10000 1010", 10).unwrap().permille(),
            100
        );
    }

    #[test]
    fn a_line_that_cannot_be_trusted_is_refused() {
        for line in [
            "step 990 9000 1060",
            "step 990 10100",
            "step x 10100 1060",
            "",
        ] {
            assert!(Spread::read(line, 10).is_err(), "{line:?}");
        }
    }
}
