//! The committed budget: `docs/budget.md` is both the page people read and the table that `cargo xtask bench` compares with.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use anyhow::{Context as _, Result, bail, ensure};

/// The page, from the workspace's root.
pub(crate) const PAGE: &str = "docs/budget.md";

/// Margin of a compiler that is not the budget's, in parts of a limit: 1.95 and 1.96 differ by up to 2 %.
const FOREIGN_MARGIN: f64 = 0.05;

/// Margin of a newly accepted value.
const FRESH_MARGIN: f64 = 0.02;

const TOOLCHAIN: &str = "Toolchain: ";

/// Head of the table; the first columns are measured, those between are for people.
const TABLE: &str = "\
| quantity | value | limit | to reach | best peer | who | how measured |
|---|---:|---:|---:|---:|---|---|
";

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Line {
    /// `row, unit`.
    quantity: String,
    value: u64,
    pub(crate) limit: u64,
    /// Goal of this project, written by a person.
    pub(crate) reach: Option<u64>,
    /// The best figure of others, measured outside this repository, and whose it is: written by a person.
    pub(crate) peer: Option<u64>,
    pub(crate) who: String,
    how: String,
}

/// A limit that a person raised: a line under the table, with the reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Raise {
    quantity: String,
    old: u64,
    new: u64,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Measured {
    pub(crate) quantity: String,
    pub(crate) value: u64,
    pub(crate) how: String,
    /// A limit that follows from a goal and not from a measurement.
    pub(crate) allowed: Option<u64>,
}

/// The committed table and the compiler whose code it measured.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Budget {
    /// Text before the toolchain's line.
    introduction: String,
    toolchain: String,
    lines: Vec<Line>,
    raises: Vec<Raise>,
    /// Text behind the table: the raises and their reasons.
    rest: String,
}

/// Findings of a comparison, one sentence each.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Verdict {
    /// The build fails for these.
    pub(crate) exceeded: Vec<String>,
    pub(crate) notes: Vec<String>,
}

impl Budget {
    pub(crate) fn read(root: &Path) -> Result<Self> {
        let text = fs::read_to_string(root.join(PAGE));
        let text = text.with_context(|| format!("cannot read {PAGE}"))?;
        Self::parse(&text).with_context(|| format!("{PAGE} is not a budget"))
    }

    pub(crate) fn write(&self, root: &Path) -> Result<()> {
        fs::write(root.join(PAGE), self.page()).with_context(|| format!("cannot write {PAGE}"))
    }

    fn parse(text: &str) -> Result<Self> {
        let (introduction, rest) = text
            .split_once(TOOLCHAIN)
            .context("there is no line `Toolchain: …`")?;
        let toolchain = rest.lines().next().unwrap_or_default().trim();
        let last = text.rsplit_once("\n| `").map_or("", |(_, last)| last);
        let rest = last.split_once('\n').map_or("", |(_, rest)| rest);
        let (mut lines, mut raises) = (Vec::new(), Vec::new());
        for row in text.lines() {
            if !row.starts_with("| `") && !row.starts_with("| raise |") {
                continue;
            }
            let number = |cell: &str| {
                let number = cell.parse();
                number.with_context(|| format!("`{cell}` is no number in: {row}"))
            };
            let optional = |cell: &str| match cell {
                "" => Ok(None),
                _ => number(cell).map(Some),
            };
            let cells: Vec<_> = row.trim_matches('|').split('|').map(str::trim).collect();
            match cells[..] {
                ["raise", quantity, old, new, why] => {
                    ensure!(!why.is_empty(), "a raise without a reason: {row}");
                    raises.push(Raise {
                        quantity: quantity.replace('`', ""),
                        old: number(old)?,
                        new: number(new)?,
                    });
                }
                [quantity, value, limit, reach, peer, who, how] => lines.push(Line {
                    quantity: quantity.replace('`', ""),
                    value: number(value)?,
                    limit: number(limit)?,
                    reach: optional(reach)?,
                    peer: optional(peer)?,
                    who: who.into(),
                    how: how.into(),
                }),
                _ => bail!("not seven cells, nor a raise: {row}"),
            }
        }
        Ok(Self {
            introduction: introduction.into(),
            toolchain: toolchain.into(),
            lines,
            raises,
            rest: rest.into(),
        })
    }

    fn page(&self) -> String {
        let (introduction, toolchain) = (&self.introduction, &self.toolchain);
        let mut page = format!("{introduction}{TOOLCHAIN}{toolchain}\n\n{TABLE}");
        let number = |cell: Option<u64>| cell.map_or(String::new(), |value| value.to_string());
        for line in &self.lines {
            let _ = writeln!(
                page,
                "| `{}` | {} | {} | {} | {} | {} | {} |",
                line.quantity,
                line.value,
                line.limit,
                number(line.reach),
                number(line.peer),
                line.who,
                line.how
            );
        }
        page + &self.rest
    }

    /// Limits that exceed the margin over their value without a line of a raise, one sentence each.
    fn unexplained(&self, measured: &[Measured]) -> Vec<String> {
        let explained = |line: &Line| {
            let goal = measured.iter().find(|m| m.quantity == line.quantity);
            let raise = self.raise(&line.quantity);
            let raised = raise.is_some_and(|raise| raise.new == line.limit);
            line.limit <= fresh(line.value)
                || raised
                || goal.is_some_and(|goal| goal.allowed == Some(line.limit))
        };
        let lines = self.lines.iter().filter(|line| !explained(line));
        let sentence = |line: &Line| {
            format!(
                "{}: the limit {} is more than 2 % above {} without a line `| raise | quantity | old | new | why |`",
                line.quantity, line.limit, line.value
            )
        };
        lines.map(sentence).collect()
    }

    /// Names of the rows of the bench program.
    pub(crate) fn rows(&self) -> impl Iterator<Item = &str> {
        let lines = self.lines.iter();
        lines.filter_map(|line| line.quantity.strip_suffix(", instructions"))
    }

    pub(crate) fn line(&self, quantity: &str) -> Option<&Line> {
        self.lines.iter().find(|line| line.quantity == quantity)
    }

    /// The last raise of a quantity; earlier ones are history.
    fn raise(&self, quantity: &str) -> Option<&Raise> {
        let mut raises = self.raises.iter().rev();
        raises.find(|raise| raise.quantity == quantity)
    }

    /// Compares with the measurements of the code of `toolchain`.
    pub(crate) fn compare(&self, toolchain: &str, measured: &[Measured]) -> Verdict {
        let (mut exceeded, mut notes) = (Vec::new(), Vec::new());
        let foreign = release(toolchain) != release(&self.toolchain);
        let margin = if foreign { FOREIGN_MARGIN } else { 0.0 };
        if foreign {
            notes.push(format!(
                "compiled by {toolchain}, budgeted for {}: every limit is widened by {:.0} %",
                self.toolchain,
                100.0 * FOREIGN_MARGIN
            ));
        }
        for m in measured {
            let (quantity, value) = (&m.quantity, m.value);
            let Some(line) = self.line(quantity) else {
                exceeded.push(format!("{quantity}: {value} has no budget"));
                continue;
            };
            let (before, limit) = (line.value, line.limit as f64 * (1.0 + margin));
            if value as f64 > limit {
                exceeded.push(format!(
                    "{quantity}: {value} exceeds {limit:.0} (was {before})"
                ));
            } else if foreign {
                // The difference is the compiler's, not a change of the code.
            } else if value < before {
                notes.push(format!("{quantity}: improved from {before} to {value}"));
            } else if value > before {
                let limit = line.limit;
                notes.push(format!(
                    "{quantity}: grew from {before} to {value}, within {limit}"
                ));
            }
        }
        let seen = |line: &Line| measured.iter().any(|m| m.quantity == line.quantity);
        for Line { quantity, .. } in self.lines.iter().filter(|line| !seen(line)) {
            exceeded.push(format!("{quantity}: is in the budget and was not measured"));
        }
        exceeded.extend(self.unexplained(measured));
        Verdict { exceeded, notes }
    }

    /// The table with the measured values. A limit follows an improvement down and never goes up by itself: a raise is a line
    /// under the table, written by a person.
    pub(crate) fn accept(&self, toolchain: &str, measured: &[Measured]) -> Result<Self> {
        if let [first, ..] = self.unexplained(measured).as_slice() {
            bail!("{first}");
        }
        let mut lines = Vec::new();
        for m in measured {
            let (quantity, value) = (&m.quantity, m.value);
            let fresh = fresh(value);
            let line = self.line(quantity);
            let before = line.map_or(fresh, |line| line.limit);
            // A raise counts from the limit that it names.
            let before = match self.raise(quantity) {
                Some(raise) if raise.old == before => raise.new,
                _ => before,
            };
            // A goal that is reached is kept.
            let reach = line.and_then(|line| line.reach);
            let goal = reach.filter(|&goal| value <= goal).unwrap_or(u64::MAX);
            let limit = m.allowed.unwrap_or(before.min(fresh).min(goal));
            ensure!(
                value <= limit,
                "{quantity}: {value} exceeds {limit}; a raise is a line under the table of {PAGE}: \
                 | raise | `{quantity}` | {limit} | {fresh} | why |"
            );
            lines.push(Line {
                quantity: quantity.clone(),
                value,
                limit,
                reach,
                peer: line.and_then(|line| line.peer),
                who: line.map_or(String::new(), |line| line.who.clone()),
                how: m.how.clone(),
            });
        }
        Ok(Self {
            toolchain: toolchain.into(),
            lines,
            ..self.clone()
        })
    }
}

/// Limit of a newly accepted value.
fn fresh(value: u64) -> u64 {
    (value as f64 * (1.0 + FRESH_MARGIN)).ceil() as u64
}

/// `rustc 1.96.0` of a version line, whoever packaged it.
fn release(line: &str) -> Vec<&str> {
    line.split_whitespace().take(2).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(value: u64) -> Vec<Measured> {
        vec![Measured {
            quantity: "friction_ur5, instructions".into(),
            value,
            how: "emulator".into(),
            allowed: None,
        }]
    }

    fn budget() -> Budget {
        Budget::default()
            .accept("rustc 1.96.0", &measured(1000))
            .unwrap()
    }

    #[test]
    fn the_page_is_the_table() {
        assert_eq!(budget().lines[0].limit, 1020);
        assert_eq!(Budget::parse(&budget().page()).unwrap(), budget());
        let committed = include_str!("../../../docs/budget.md");
        assert_eq!(Budget::parse(committed).unwrap().page(), committed);
    }

    #[test]
    fn a_value_beyond_its_limit_fails_and_a_better_one_is_named() {
        let verdict = |toolchain: &str, value| budget().compare(toolchain, &measured(value));
        assert_eq!(verdict("rustc 1.96.0", 1000), Verdict::default());
        assert_eq!(verdict("rustc 1.96.0", 1021).exceeded.len(), 1);
        assert_eq!(verdict("rustc 1.96.0", 1020).exceeded.len(), 0);
        assert!(verdict("rustc 1.96.0", 900).notes[0].contains("improved from 1000 to 900"));
        let foreign = verdict("rustc 1.95.0", 1070);
        assert_eq!(foreign.exceeded.len(), 0);
        assert!(foreign.notes[0].contains("rustc 1.95.0"));
        assert_eq!(verdict("rustc 1.95.0", 1072).exceeded.len(), 1);
    }

    #[test]
    fn a_quantity_without_a_budget_or_a_measurement_fails() {
        let unknown = Budget::default().compare("x", &measured(1));
        let unmeasured = budget().compare("rustc 1.96.0", &[]);
        assert_eq!([unknown, unmeasured].map(|it| it.exceeded.len()), [1, 1]);
    }

    #[test]
    fn an_allowed_value_keeps_its_limit_and_a_person_s_text_is_kept() {
        let mut measured = measured(3);
        measured[0].allowed = Some(50);
        let with_goal = budget()
            .page()
            .replace("|  |  |  |", "| 1000 | 1790 | Pinocchio |");
        let page = format!("Cost\n\n{with_goal}\nwords\n");
        let accepted = Budget::parse(&page)
            .unwrap()
            .accept("rustc 1.96.0", &measured);
        assert_eq!(
            accepted.unwrap().page(),
            page.replace("| 1000 | 1020 |", "| 3 | 50 |")
        );
    }

    #[test]
    fn a_raise_needs_a_line_with_its_reason() {
        let page = budget().page();
        let by_hand = Budget::parse(&page.replace("| 1020 |", "| 1500 |")).unwrap();
        let (rustc, measured_1400) = ("rustc 1.96.0", &measured(1400)[..]);
        assert_eq!(by_hand.compare(rustc, measured_1400).exceeded.len(), 1);
        assert!(by_hand.accept(rustc, measured_1400).is_err());
        let line = "| raise | `friction_ur5, instructions` | 1020 | 1500 | nine columns |\n";
        let raised = Budget::parse(&format!("{page}{line}")).unwrap();
        let accepted = raised.accept(rustc, measured_1400).unwrap();
        assert_eq!(accepted.lines[0].limit, 1428);
        assert!(accepted.page().contains(line) && raised.accept("x", &measured(1501)).is_err());
        assert_eq!(accepted.compare(rustc, measured_1400), Verdict::default());
        assert!(Budget::parse(&format!("{page}| raise | `a` | 1 | 2 | |\n")).is_err());
    }

    #[test]
    fn a_goal_that_is_reached_is_the_limit() {
        let accept = |value| {
            let mut budget = Budget::default().accept("x", &measured(2000)).unwrap();
            budget.lines[0].reach = Some(1200);
            budget.accept("x", &measured(value)).unwrap().lines[0].limit
        };
        assert_eq!([1100, 1199, 1201].map(accept), [1122, 1200, 1226]);
    }

    #[test]
    fn accepting_lowers_limits_and_never_raises_them() {
        let accept = |value| budget().accept("rustc 1.96.0", &measured(value));
        assert_eq!(accept(900).unwrap().lines[0].limit, 918);
        assert_eq!(accept(1015).unwrap().lines[0].limit, 1020);
        assert!(accept(1021).is_err());
    }
}
