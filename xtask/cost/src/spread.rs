//! The long run: spread of a tick's instructions over many different samples.

use anyhow::{Context as _, Result, ensure};

/// Ticks of the long run.
pub(crate) const TICKS: u32 = 100_000;

/// Largest distance of a tick from the mean, in thousandths of it: jitter of the tick is jitter of the torque.
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
        let read = || {
            let mut words = line.split(' ');
            let row = words.next()?.to_owned();
            let mut number = || words.next()?.parse::<u64>().ok();
            let (least, sum, most) = (number()?, number()?, number()?);
            Some(Self {
                row,
                ticks,
                least: u32::try_from(least).ok()?,
                mean: sum as f64 / f64::from(ticks),
                most: u32::try_from(most).ok()?,
            })
        };
        let spread = read().with_context(|| format!("no long run in `{line}`"))?;
        let range = f64::from(spread.least)..=f64::from(spread.most);
        ensure!(
            range.contains(&spread.mean),
            "the long run cannot be trusted: `{line}`"
        );
        Ok(spread)
    }

    /// Spread without the `bracket` that every count includes.
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

    /// Largest distance from the mean in thousandths of it, rounded up.
    pub(crate) fn permille(&self) -> u64 {
        (1000.0 * self.deviation()).ceil() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_the_larger_distance_from_the_mean() {
        let spread = |line| Spread::read(line, 10).unwrap();
        assert_eq!(spread("step 990 10100 1060").permille(), 50);
        assert_eq!(spread("step 990 10100 1060").without(10).mean, 1000.0);
        assert_eq!(spread("step 900 10000 1010").permille(), 100);
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
