//! The text of the budget's page, written and read.

use std::fmt::Write as _;

use anyhow::{Context as _, Result, bail, ensure};

use super::{Budget, Line, Raise};

const TOOLCHAIN: &str = "Toolchain: ";

/// Head of the table; the first columns are measured, those between are for people.
const TABLE: &str = "\
| quantity | value | limit | to reach | best peer | who | how measured |
|---|---:|---:|---:|---:|---|---|
";

impl Budget {
    pub(super) fn parse(text: &str) -> Result<Self> {
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

    pub(super) fn page(&self) -> String {
        let Self {
            introduction,
            toolchain,
            ..
        } = self;
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
}
