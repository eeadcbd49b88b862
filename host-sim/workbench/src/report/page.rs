//! The report template: one HTML file, nothing fetched; a script only shows values and zooms in plots.

use super::plot::{Panel, grid};
use super::{PlotColor, escape, style_sheet, variables};
use std::fmt::Display;

/// A report as a page: title, lead, figures in large type, sections.
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    title: String,
    lead: String,
    cards: Vec<(String, String)>,
    sections: Vec<Section>,
}

/// Colours of curves with their names.
pub type Legend = Vec<(PlotColor, String)>;

/// A section of a page: heading, one sentence, legend, then plots, tables and commands.
#[derive(Clone, Debug, PartialEq)]
pub struct Section {
    heading: String,
    caption: String,
    legend: Legend,
    parts: Vec<Part>,
}

#[derive(Clone, Debug, PartialEq)]
enum Part {
    Plots(Vec<Panel>, u32),
    Table(String, Vec<Vec<String>>),
    Command(String),
}

impl Page {
    /// A page without content.
    pub fn new(title: impl Into<String>, lead: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            lead: lead.into(),
            cards: Vec::new(),
            sections: Vec::new(),
        }
    }

    /// Adds a figure in large type, with its unit, and its label.
    pub fn card(mut self, value: impl Display, label: impl Into<String>) -> Self {
        self.cards.push((value.to_string(), label.into()));
        self
    }

    /// Adds sections.
    pub fn sections(mut self, sections: impl IntoIterator<Item = Section>) -> Self {
        self.sections.extend(sections);
        self
    }

    /// The page as HTML.
    ///
    /// Errors: those of the plot library.
    pub fn html(&self) -> std::io::Result<String> {
        let cards = self.cards.iter().map(|(value, label)| {
            let (value, label) = (escape(value), escape(label));
            format!("<div class=\"card\"><b>{value}</b><span>{label}</span></div>\n")
        });
        let sections: std::io::Result<String> = self.sections.iter().map(Section::html).collect();
        let sections = sections?;
        let script = match sections.contains("data-area") {
            true => format!("<script>\n{SCRIPT}</script>\n"),
            false => String::new(),
        };
        Ok(format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
             <meta name=\"color-scheme\" content=\"light dark\">\
             <title>{title}</title>\n<style>\n{variables}{STYLE}{colors}</style></head>\n<body><main>\n\
             <h1>{title}</h1>\n<p class=\"lead\">{lead}</p>\n<div class=\"cards\">\n{cards}</div>\n{sections}\
             </main>{script}</body></html>\n",
            title = escape(&self.title),
            lead = escape(&self.lead),
            variables = variables(),
            colors = style_sheet(),
            cards = cards.collect::<String>(),
        ))
    }
}

impl Section {
    /// A section without content.
    pub fn new(heading: impl Into<String>, caption: impl Into<String>) -> Self {
        Self {
            heading: heading.into(),
            caption: caption.into(),
            legend: Vec::new(),
            parts: Vec::new(),
        }
    }

    /// Sets the legend.
    pub fn legend<T: Into<String>>(
        mut self,
        legend: impl IntoIterator<Item = (PlotColor, T)>,
    ) -> Self {
        let named = legend.into_iter().map(|(color, name)| (color, name.into()));
        self.legend = named.collect();
        self
    }

    /// Adds panels in rows of at most `columns`.
    pub fn plots(mut self, panels: impl Into<Vec<Panel>>, columns: u32) -> Self {
        self.parts.push(Part::Plots(panels.into(), columns));
        self
    }

    /// Adds a table. Headings are separated by ` | `; the first column is text, the others are numbers.
    pub fn table<R: IntoIterator<Item = String>>(
        mut self,
        header: impl Into<String>,
        rows: impl IntoIterator<Item = R>,
    ) -> Self {
        let rows = rows.into_iter().map(|row| row.into_iter().collect());
        self.parts.push(Part::Table(header.into(), rows.collect()));
        self
    }

    /// Adds a table with one row a joint and one column a heading after the first.
    pub fn joint_table(self, header: &str, columns: &[&[f64]]) -> Self {
        let joints = columns.first().map_or(0, |column| column.len());
        self.table(
            header,
            (0..joints).map(|j| {
                let values = columns
                    .iter()
                    .map(move |column| format!("{:.3}", column[j]));
                std::iter::once(format!("joint {}", j + 1)).chain(values)
            }),
        )
    }

    /// Adds a shell command.
    pub fn command(mut self, line: impl Into<String>) -> Self {
        self.parts.push(Part::Command(line.into()));
        self
    }

    fn html(&self) -> std::io::Result<String> {
        let legend = self.legend.iter().map(|(color, name)| {
            let (variable, name) = (color.variable(), escape(name));
            format!("<span><i style=\"background:var({variable})\"></i>{name}</span>")
        });
        let parts: std::io::Result<String> = self.parts.iter().map(Part::html).collect();
        Ok(format!(
            "<section><h2>{}</h2>\n<p>{}</p>\n<div class=\"legend\">{}</div>\n{}\n</section>\n",
            escape(&self.heading),
            escape(&self.caption),
            legend.collect::<String>(),
            parts?
        ))
    }
}

impl Part {
    fn html(&self) -> std::io::Result<String> {
        Ok(match self {
            Self::Plots(panels, columns) => grid(panels, *columns)?,
            Self::Command(line) => format!("<pre>{}</pre>\n", escape(line)),
            Self::Table(header, rows) => {
                // Words stand to the left, numbers to the right.
                let class = |column: usize| {
                    let mut cells = rows.iter().filter_map(|row| row.get(column));
                    match cells.any(|cell| cell.starts_with(char::is_alphabetic)) {
                        true => " class=\"text\"",
                        false => "",
                    }
                };
                let classes: Vec<&str> = (0..header.split(" | ").count()).map(class).collect();
                let cells = |tag: &str, row: &mut dyn Iterator<Item = &str>| -> String {
                    let cells = row.zip(classes.iter().chain(std::iter::repeat(&"")));
                    cells
                        .map(|(cell, class)| format!("<{tag}{class}>{}</{tag}>", escape(cell)))
                        .collect()
                };
                let head = cells("th", &mut header.split(" | "));
                let rows = rows.iter().map(|row| {
                    let class = class_of(row);
                    let row = cells("td", &mut row.iter().map(String::as_str));
                    format!("<tr{class}>{row}</tr>\n")
                });
                let body: String = rows.collect();
                format!(
                    "<div class=\"wide\"><table><thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table></div>"
                )
            }
        })
    }
}

/// A ratio in percent, one decimal.
pub fn percent(ratio: f64) -> String {
    format!("{:.1} %", 100.0 * ratio)
}

/// A figure with so many decimals, more where two digits need them.
pub fn figure(value: f64, decimals: usize) -> String {
    // Less than a billionth is zero. A number below zero becomes zero as a count.
    let needed = match value.abs() {
        size if size >= 1e-9 => (1.0 - size.log10().floor()) as usize,
        _ => 0,
    };
    let decimals = decimals.max(needed);
    format!("{value:.decimals$}")
}

/// `value` as `written`, or a dash if there is none.
pub fn or_dash<T>(value: Option<T>, written: impl FnOnce(T) -> String) -> String {
    value.map_or("–".to_owned(), written)
}

/// A ratio with three decimals, or a dash if there is none.
pub fn ratio(value: Option<f64>) -> String {
    or_dash(value, |value| format!("{value:.3}"))
}

/// Hover and zoom of the plots.
const SCRIPT: &str = include_str!("interact.js");

/// Class of a row by the verdict in one of its cells.
fn class_of(row: &[String]) -> &'static str {
    let has = |words: &[&str]| {
        row.iter()
            .any(|cell| words.contains(&cell.to_lowercase().as_str()))
    };
    if has(&["missed", "wrong", "no"]) {
        " class=\"bad\""
    } else if has(&["warning"]) {
        " class=\"warn\""
    } else {
        ""
    }
}

/// Layout and type; the colours are variables.
const STYLE: &str = include_str!("style.css");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_figure_has_two_digits() {
        for (value, decimals, wanted) in [
            (0.25, 2, "0.25"),
            (-0.034, 2, "-0.034"),
            (6.4e-5, 2, "0.000064"),
            (12.3456, 3, "12.346"),
            (0.03, 0, "0.030"),
            (0.0, 2, "0.00"),
            (1e-20, 2, "0.00"),
        ] {
            assert_eq!(figure(value, decimals), wanted);
        }
    }

    #[test]
    fn a_page_fetches_nothing_and_escapes_its_text() {
        let section = Section::new("h", "c").legend([(PlotColor::After, "\"after\"")]);
        let page = Page::new("a < b", "lead & more")
            .card(1, "<one>")
            .sections([section.table("name | x | y", [["<row>", "2", "no"].map(str::to_owned)])]);
        let page = page.html().expect("no plots");
        for fetched in ["http", "src=", "@import", "url(", "<script"] {
            assert!(!page.contains(fetched), "{fetched}");
        }
        assert!(
            page.contains("<td>&lt;row&gt;</td><td>2</td><td class=\"text\">no")
                && page.contains("&lt;one&gt;")
        );
    }
}
