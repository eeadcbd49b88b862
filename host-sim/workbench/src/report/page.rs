//! The page around the plots: one file, no script, nothing fetched.

use super::ink::{Ink, style_sheet, variables};
use super::markup::escaped;

/// A figure in large type at the top of the page.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// The number with its unit.
    pub value: String,
    /// What it is.
    pub label: String,
}

/// A part of the page: heading, one sentence on what is seen, legend, body.
#[derive(Clone, Debug, PartialEq)]
pub struct Section {
    /// Heading.
    pub heading: String,
    /// What is seen, in one sentence.
    pub caption: String,
    /// Colours and what they stand for.
    pub legend: Vec<(Ink, String)>,
    /// SVG or a table, as HTML.
    pub body: String,
}

impl Section {
    /// A part that is a table.
    pub fn of_table(heading: &str, caption: &str, header: &[&str], rows: &[Vec<String>]) -> Self {
        Self {
            heading: heading.to_owned(),
            caption: caption.to_owned(),
            legend: Vec::new(),
            body: table(header, rows),
        }
    }
}

impl Tile {
    /// A ratio.
    pub fn ratio(value: f64, label: &str) -> Self {
        Self {
            value: ratio(Some(value)),
            label: label.to_owned(),
        }
    }
}

/// A ratio as tables show it; a dash where there is none.
pub fn ratio(value: Option<f64>) -> String {
    value.map_or("–".to_owned(), |value| format!("{value:.3}"))
}

/// A table with a header row; the first column is text, the others are numbers.
pub fn table(header: &[&str], rows: &[Vec<String>]) -> String {
    let cells = |tag: &str, row: &mut dyn Iterator<Item = &str>| -> String {
        row.map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell)))
            .collect()
    };
    let body: String = rows
        .iter()
        .map(|row| {
            format!(
                "<tr>{}</tr>\n",
                cells("td", &mut row.iter().map(String::as_str))
            )
        })
        .collect();
    format!(
        "<div class=\"wide\"><table><thead><tr>{}</tr></thead><tbody>\n{body}</tbody></table></div>",
        cells("th", &mut header.iter().copied())
    )
}

/// A line to type into a shell.
pub fn command(line: &str) -> String {
    format!("<pre>{}</pre>\n", escaped(line))
}

/// The whole page.
pub fn html(title: &str, lead: &str, tiles: &[Tile], sections: &[Section]) -> String {
    let tiles: String = tiles
        .iter()
        .map(|tile| {
            format!(
                "<div class=\"tile\"><b>{}</b><span>{}</span></div>\n",
                escaped(&tile.value),
                escaped(&tile.label)
            )
        })
        .collect();
    let sections: String = sections.iter().map(section).collect();
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\
         <meta name=\"color-scheme\" content=\"light dark\">\
         <title>{title}</title>\n<style>\n{colours}{STYLE}{inks}</style></head>\n<body><main>\n\
         <h1>{title}</h1>\n<p class=\"lead\">{lead}</p>\n<div class=\"tiles\">\n{tiles}</div>\n{sections}\
         </main></body></html>\n",
        title = escaped(title),
        lead = escaped(lead),
        colours = variables(),
        inks = style_sheet(),
    )
}

fn section(section: &Section) -> String {
    let legend: String = section
        .legend
        .iter()
        .map(|(ink, name)| {
            format!(
                "<span><i style=\"background:var({})\"></i>{}</span>",
                ink.variable(),
                escaped(name)
            )
        })
        .collect();
    format!(
        "<section><h2>{}</h2>\n<p>{}</p>\n<div class=\"legend\">{legend}</div>\n{}\n</section>\n",
        escaped(&section.heading),
        escaped(&section.caption),
        section.body
    )
}

const STYLE: &str = "\
*{box-sizing:border-box}body{margin:0;background:var(--page);color:var(--text);font:16px/1.5 system-ui,-apple-system,\"Segoe UI\",Roboto,sans-serif}
main{max-width:1160px;margin:0 auto;padding:32px 20px 64px}h1{font-size:1.9rem;margin:0 0 4px;letter-spacing:-.01em}
h2{font-size:1.2rem;margin:0 0 4px}p{margin:0 0 10px;max-width:80ch;color:var(--quiet)}.lead{font-size:1.05rem;margin-bottom:20px}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(190px,1fr));gap:12px;margin-bottom:20px}
.tile,section{background:var(--card);border:1px solid var(--line);border-radius:10px}.tile{padding:14px 16px}
.tile b{display:block;font-size:1.2rem;font-variant-numeric:tabular-nums}.tile span{color:var(--quiet);font-size:.86rem}
section{padding:20px 20px 14px;margin-bottom:18px}.legend{display:flex;flex-wrap:wrap;gap:4px 18px;font-size:.88rem;margin-bottom:4px}
.legend i{display:inline-block;width:18px;height:4px;border-radius:2px;margin-right:6px;vertical-align:middle}
.panels{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,var(--least)),1fr));gap:4px 10px;margin-bottom:10px}svg{display:block;width:100%;height:auto}.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.92rem;font-variant-numeric:tabular-nums}
@media (max-width:520px){main{padding:20px 10px 40px}section{padding:14px 12px 10px}th,td{padding-right:8px;font-size:.82rem}}
pre{margin:0 0 12px;padding:10px 12px;border:1px solid var(--line);border-radius:6px;white-space:pre-wrap;overflow-wrap:anywhere;font-size:.88rem}
th,td{text-align:right;padding:4px 14px 4px 0;border-bottom:1px solid var(--line)}th{font-weight:600}th:first-child,td:first-child{text-align:left}
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_fetches_nothing_and_escapes_its_text() {
        let page = html(
            "a < b",
            "lead & more",
            &[Tile {
                value: "1".to_owned(),
                label: "<one>".to_owned(),
            }],
            &[Section {
                heading: "h".to_owned(),
                caption: "c".to_owned(),
                legend: vec![(Ink::After, "\"after\"".to_owned())],
                body: table(&["name", "x"], &[vec!["<row>".to_owned(), "2".to_owned()]]),
            }],
        );
        for fetched in ["http", "src=", "@import", "url(", "<script"] {
            assert!(!page.contains(fetched), "{fetched}");
        }
        assert!(page.contains("&lt;row&gt;") && page.contains("&lt;one&gt;"));
    }
}
