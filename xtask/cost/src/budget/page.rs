//! The text of the budget's page, written and read.

use std::fmt::Write as _;

use anyhow::{Context as _, Result, bail, ensure};

use super::{Budget, Line, Raise};
use crate::anchors;

impl Budget {
    pub(super) fn parse(text: &str) -> Result<Self> {
        let toolchain = text
            .lines()
            .find_map(|line| line.strip_prefix("Toolchain: "))
            .context("there is no line `Toolchain: …`")?;
        let mut lines = Vec::new();
        let mut raises = Vec::new();
        let number = |cell: &str, row: &str| {
            let number = cell.parse();
            number.with_context(|| format!("`{cell}` is no number in: {row}"))
        };
        for row in text.lines() {
            if !row.starts_with("| `") && !row.starts_with("| raise |") {
                continue;
            }
            let cells: Vec<_> = row.trim_matches('|').split('|').map(str::trim).collect();
            match cells[..] {
                ["raise", quantity, old, new, why] => {
                    ensure!(!why.is_empty(), "a raise without a reason: {row}");
                    raises.push(Raise {
                        quantity: quantity.replace('`', ""),
                        old: number(old, row)?,
                        new: number(new, row)?,
                        why: why.into(),
                    });
                }
                // The columns between are for people.
                [quantity, value, limit, .., how] => lines.push(Line {
                    quantity: quantity.replace('`', ""),
                    value: number(value, row)?,
                    limit: number(limit, row)?,
                    how: how.into(),
                }),
                _ => bail!("not four cells or more: {row}"),
            }
        }
        let toolchain = toolchain.trim().into();
        Ok(Self {
            toolchain,
            lines,
            raises,
        })
    }

    pub(super) fn page(&self) -> String {
        let mut page = format!("{INTRODUCTION}\nToolchain: {}\n\n", self.toolchain);
        page.push_str(
            "| quantity | value | limit | to reach | best peer | who | how measured |\n\
             |---|---:|---:|---:|---:|---|---|\n",
        );
        for Line {
            quantity,
            value,
            limit,
            how,
        } in &self.lines
        {
            let number = |value: Option<u32>| value.map_or(String::new(), |v| v.to_string());
            let reach = number(anchors::reach(quantity));
            let peer = anchors::peer(quantity);
            let best = number(peer.map(|peer| peer.value));
            let who = peer.map_or("", |peer| peer.who);
            let _ = writeln!(
                page,
                "| `{quantity}` | {value} | {limit} | {reach} | {best} | {who} | {how} |"
            );
        }
        if !self.raises.is_empty() {
            page.push_str(RAISES);
        }
        for Raise {
            quantity,
            old,
            new,
            why,
        } in &self.raises
        {
            let _ = writeln!(page, "| raise | `{quantity}` | {old} | {new} | {why} |");
        }
        page
    }
}

const INTRODUCTION: &str = r#"# Budget

The cost of the firmware.
`cargo xtask bench` measures every line, fails where a value exceeds its limit, and reports improvements.
`cargo xtask bench --accept` writes this page: values as measured, limits at most 2 % above them and never higher than before.
No limit exceeds a goal that is reached.
A raise is a line under the table, with quantity, old limit, new limit and reason; without it the bench fails.
The bench knows a raise by a limit more than 2 % above its value.

Instructions are executed instructions in the emulator, the same on every run: the mean over calls with varying inputs.
Cycles are *estimates* for a Cortex-M4 with zero-wait memory.
They follow from the executed instructions and the cycle tables of ARM DDI 0439; nothing was measured on silicon.
Bytes are those of the flashable firmware.
Lines without a number of joints are of the UR5, 6 joints; those of 7 are of the Panda, those of 8 of `host-sim/robots/eight.toml`.
Another compiler than the one named here gets 5 % more.

The column "to reach" is the goal of the project, the column "best peer" the best known code, measured alike.
The compiler gcc fuses the multiplications of the peers with additions.
This code never fuses: its results are the same bits on every machine.
"#;

/// Head of the raises.
const RAISES: &str = "
## Raised limits

| | quantity | old | new | why |
|---|---|---:|---:|---|
";
