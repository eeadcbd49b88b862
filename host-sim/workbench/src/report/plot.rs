//! Line plots as SVG that takes its colours from the page, so that it reads in light and in dark.

pub use super::PlotColor;

use super::{escape, light, rgb};
use plotters::coord::Shift;
use plotters::prelude::*;
use serde_json::json;
use std::io;

/// A curve of a panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Its colour.
    pub color: PlotColor,
    /// Points, x ascending.
    pub points: Vec<(f64, f64)>,
}

/// One pair of axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Heading.
    pub title: String,
    /// Quantity and unit of x.
    pub x_label: String,
    /// Quantity and unit of y.
    pub y_label: String,
    /// Curves, the first one lowest.
    pub curves: Vec<Curve>,
    /// The y axis starts at zero.
    pub from_zero: bool,
}

impl Curve {
    /// Curve through `pick` of every point.
    pub fn new<T>(color: PlotColor, points: &[T], pick: impl Fn(&T) -> (f64, f64)) -> Self {
        Self {
            color,
            points: points.iter().map(pick).collect(),
        }
    }
}

impl Panel {
    /// Panel with the given heading, axis labels and curves.
    pub fn new(title: impl Into<String>, x_label: &str, y_label: &str, curves: Vec<Curve>) -> Self {
        Self {
            title: title.into(),
            x_label: x_label.to_owned(),
            y_label: y_label.to_owned(),
            curves,
            from_zero: false,
        }
    }

    /// One panel over time for each of so many joints.
    pub fn of_joints(
        joints: usize,
        y_label: &str,
        curves: impl Fn(usize) -> Vec<Curve>,
    ) -> Vec<Self> {
        (0..joints)
            .map(|j| Self::new(format!("joint {}", j + 1), "t / s", y_label, curves(j)))
            .collect()
    }
}

/// SVG units a CSS pixel: plotters rounds coordinates to whole units.
const FINE: u32 = 3;
/// Buckets of the points that a curve keeps in a drawing, and of those that it keeps for hover and zoom.
const BUCKETS: usize = 260;
const FINE_BUCKETS: usize = 700;

/// Panels of a page, one SVG each, in rows of at most `columns`, fewer in a narrow window.
pub(super) fn grid(panels: &[Panel], columns: u32) -> io::Result<String> {
    let (width, height) = match columns {
        1 => (900, 280),
        2 => (560, 250),
        _ => (370, 250),
    };
    // The page is 1078 pixels wide inside: this fits `columns` times and not once more.
    let least = 900 / columns.max(1);
    let mut html = format!("<div class=\"panels\" style=\"--least:{least}px\">\n");
    for panel in panels {
        let (svg, area) = single(panel, (width * FINE, height * FINE))?;
        let ((x0, x1), (y0, y1)) = ranges(panel);
        let [left, right, top, bottom] = area;
        // The data stand in the description of the drawing, which a screen reader does not read after its label.
        let marked = format!(
            "<svg data-area=\"{left} {right} {top} {bottom}\" data-range=\"{x0} {x1} {y0} {y1}\""
        );
        let svg = svg.replacen("<svg", &marked, 1);
        let end = svg.rfind("</svg>").unwrap_or(svg.len());
        html += &format!("{}<desc>{}</desc>{}", &svg[..end], data(panel), &svg[end..]);
    }
    Ok(html + "</div>\n")
}

/// Panels in rows of `columns`, each `width` × `height` pixels, under a title and a legend: one SVG for a file of its own.
///
/// Errors: those of the plot library.
pub fn picture(
    title: &str,
    legend: &[(PlotColor, String)],
    panels: &[Panel],
    columns: u32,
    (width, height): (u32, u32),
) -> io::Result<String> {
    const HEAD: u32 = 64;
    let columns = columns.max(1);
    let rows = (panels.len() as u32).div_ceil(columns);
    let (all_width, all_height) = (columns * width, HEAD + rows * height);
    let text = |x: u32, y: u32, size: u32, words: &str| {
        let colour = light("--text");
        let words = escape(words);
        format!("<text x=\"{x}\" y=\"{y}\" font-size=\"{size}\" fill=\"{colour}\">{words}</text>\n")
    };
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{all_width}\" height=\"{all_height}\" \
         viewBox=\"0 0 {all_width} {all_height}\" font-family=\"sans-serif\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"{}\"/>\n",
        light("--card")
    );
    svg += &text(14, 24, 16, title);
    let mut x = 14;
    for (color, name) in legend {
        let colour = light(&color.variable());
        svg += &format!("<rect x=\"{x}\" y=\"44\" width=\"18\" height=\"4\" fill=\"{colour}\"/>\n");
        svg += &text(x + 24, 50, 12, name);
        // Sans-serif letters of 12 pixels are about 7 wide.
        x += 42 + 7 * name.chars().count() as u32;
    }
    for (number, panel) in (0..).zip(panels) {
        let (x, y) = (number % columns * width, HEAD + number / columns * height);
        let (drawing, _) = single(panel, (width * FINE, height * FINE))?;
        let placed = format!("<svg x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\"");
        svg += &drawing.replacen("<svg", &placed, 1);
    }
    Ok(svg + "</svg>\n")
}

/// A panel, and the left, right, top and bottom of its plotting area.
fn single(panel: &Panel, size: (u32, u32)) -> io::Result<(String, [i32; 4])> {
    let mut svg = String::new();
    let area;
    {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        area = draw(panel, &root).map_err(io::Error::other)?;
        root.present().map_err(io::Error::other)?;
    }
    // The page scales the drawing to its own width.
    let shown = format!("<svg width=\"{}\" height=\"{}\"", size.0, size.1);
    let (title, x, y) = (&panel.title, &panel.x_label, &panel.y_label);
    let label = escape(&format!("{title}: {y} over {x}"));
    let scaled = format!("<svg role=\"img\" aria-label=\"{label}\"");
    Ok((svg.replacen(&shown, &scaled, 1), area))
}

fn draw(
    panel: &Panel,
    area: &DrawingArea<SVGBackend<'_>, Shift>,
) -> Result<[i32; 4], DrawingAreaErrorKind<io::Error>> {
    let text = rgb("--text");
    let font = |size: u32| ("sans-serif", size * FINE).into_font().color(&text);
    let ((x0, x1), (y0, y1)) = ranges(panel);
    let mut chart = ChartBuilder::on(area)
        .margin(8 * FINE)
        .caption(&panel.title, font(14))
        .x_label_area_size(34 * FINE)
        .y_label_area_size(52 * FINE)
        .build_cartesian_2d(x0..x1, y0..y1)?;
    chart
        .configure_mesh()
        .max_light_lines(0)
        .bold_line_style(rgb("--grid").stroke_width(FINE))
        .axis_style(rgb("--axis").stroke_width(FINE))
        .label_style(font(11))
        .axis_desc_style(font(12))
        .x_labels(6)
        .y_labels(5)
        .y_label_formatter(&|value| short(*value, y1 - y0))
        .x_label_formatter(&|value| short(*value, x1 - x0))
        .x_desc(&panel.x_label)
        .y_desc(&panel.y_label)
        .draw()?;
    for curve in &panel.curves {
        let width = line_width(curve);
        chart.draw_series(LineSeries::new(
            thinned(&curve.points, BUCKETS),
            rgb(&curve.color.variable()).stroke_width(width),
        ))?;
    }
    let (x, y) = chart.plotting_area().get_pixel_range();
    Ok([x.start, x.end, y.start, y.end])
}

/// Width of a curve: the truth shows on both sides of a curve that lies on it.
fn line_width(curve: &Curve) -> u32 {
    match curve.color {
        PlotColor::Truth => 4 * FINE,
        _ => FINE + 1,
    }
}

/// Curves of a panel for hover and zoom, as JSON: colour, width, x and y.
fn data(panel: &Panel) -> String {
    // Five digits of the span are finer than a screen; JSON has null for what is not finite.
    let digits = |(low, high): (f64, f64)| {
        let spans = low.abs().max(high.abs()) / (high - low);
        (5.0 + spans.log10().ceil().max(0.0)) as usize
    };
    let rounded = |value: f64, digits: usize| {
        let text = format!("{value:.digits$e}");
        text.parse::<f64>().unwrap_or(f64::NAN)
    };
    let (x, y) = ranges(panel);
    let (x_digits, y_digits) = (digits(x), digits(y));
    let curves = panel.curves.iter().map(|curve| {
        let points = thinned(&curve.points, FINE_BUCKETS).into_iter();
        let points = points.map(|(x, y)| (rounded(x, x_digits), rounded(y, y_digits)));
        let (x, y): (Vec<f64>, Vec<f64>) = points.unzip();
        json!({"c": curve.color.variable(), "w": line_width(curve), "x": x, "y": y})
    });
    serde_json::Value::from_iter(curves).to_string()
}

/// As many decimals as the span of the axis asks for.
fn short(value: f64, span: f64) -> String {
    let decimals = (1.0 - span.log10()).ceil().clamp(0.0, 4.0) as usize;
    let zero = value.abs() < span * 1e-9;
    format!("{:.decimals$}", if zero { 0.0 } else { value })
}

fn ranges(panel: &Panel) -> ((f64, f64), (f64, f64)) {
    let (mut x, mut y) = ((f64::MAX, f64::MIN), (f64::MAX, f64::MIN));
    for &(px, py) in panel.curves.iter().flat_map(|curve| &curve.points) {
        if px.is_finite() && py.is_finite() {
            x = (x.0.min(px), x.1.max(px));
            y = (y.0.min(py), y.1.max(py));
        }
    }
    if panel.from_zero {
        y.0 = 0.0;
    }
    let widen = |(low, high): (f64, f64), share: f64| {
        // Of times of a clock, too, the next numbers are this far apart.
        let margin = ((high - low) * share).max(1e-9 * low.abs().max(high.abs()).max(1.0));
        match low > high {
            true => (0.0, 1.0),
            false => (low - margin, high + margin),
        }
    };
    let (x, mut y) = (widen(x, 0.0), widen(y, 0.06));
    if panel.from_zero {
        y.0 = 0.0;
    }
    (x, y)
}

/// At most 2 points a bucket: the lowest and the highest, in their order, so that no peak is lost.
fn thinned(points: &[(f64, f64)], buckets: usize) -> Vec<(f64, f64)> {
    if points.len() <= 2 * buckets {
        return points.to_vec();
    }
    let mut kept = Vec::with_capacity(2 * buckets);
    for bucket in points.chunks(points.len().div_ceil(buckets)) {
        let by_height = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let (low, high) = (
            bucket.iter().min_by(by_height),
            bucket.iter().max_by(by_height),
        );
        let mut ends: Vec<_> = low.into_iter().chain(high).copied().collect();
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        kept.extend(ends);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_point_at_the_time_of_a_clock_is_drawn() {
        let points = vec![(1.7e9, 2.0)];
        let color = PlotColor::Truth;
        let panel = Panel::new("one", "t / s", "q / rad", vec![Curve { color, points }]);
        let page = grid(&[panel], 1).expect("drawn");
        assert!(page.contains("1700000000"), "{page}");
    }

    #[test]
    fn thinning_keeps_every_peak_and_the_order() {
        let points = (0..30_000).map(|k| (f64::from(k), (f64::from(k) * 1e-3).sin()));
        let mut points: Vec<(f64, f64)> = points.collect();
        points[12_345].1 = 50.0;
        let kept = thinned(&points, BUCKETS);
        assert!(kept.len() <= 2 * BUCKETS);
        assert!(kept.contains(&(12_345.0, 50.0)));
        assert!(kept.windows(2).all(|pair| pair[0].0 <= pair[1].0));
    }

    fn panel(title: &str, color: PlotColor) -> Panel {
        let points = [(0.0, 1.0), (1.0, 2.0)];
        let curve = Curve::new(color, &points, |point| *point);
        Panel::new(title, "t / s", "tau / N·m", vec![curve])
    }

    #[test]
    fn large_times_keep_their_differences() {
        let points = (0..400).map(|k| (1.7e9 + 0.1 * f64::from(k), 0.0));
        let points: Vec<(f64, f64)> = points.collect();
        let curve = Curve::new(PlotColor::Truth, &points, |point| *point);
        let kept = data(&Panel::new("a", "t / s", "q / rad", vec![curve]));
        let curves: Vec<serde_json::Value> = serde_json::from_str(&kept).expect("JSON");
        let x = curves[0]["x"].as_array().expect("x");
        for (x, (kept, _)) in x.iter().zip(points) {
            assert!((x.as_f64().expect("a number") - kept).abs() < 1e-3);
        }
    }

    #[test]
    fn the_style_sheet_translates_every_colour_of_a_drawing() {
        let panels = [
            panel("<tau & more>", PlotColor::Truth),
            panel("b", PlotColor::Joint(7)),
        ];
        let svg = grid(&panels, 1).expect("draws");
        let sheet = crate::report::style_sheet();
        for piece in svg.split("=\"#").skip(1) {
            let hex = piece.split('"').next().unwrap_or_default();
            assert!(sheet.contains(hex), "{hex}");
        }
        assert!(!svg.contains("<tau"), "text is escaped");
    }

    #[test]
    fn a_picture_needs_no_style_sheet_and_names_its_curves() {
        let panels = ["a", "b", "c"].map(|title| panel(title, PlotColor::Joint(1)));
        let legend = [(PlotColor::Joint(1), "joint <2>".to_owned())];
        let svg = picture("all", &legend, &panels, 2, (300, 200)).expect("draws");
        roxmltree::Document::parse(&svg).expect("is XML");
        assert!(svg.contains("viewBox=\"0 0 600 464\"") && svg.contains("joint &lt;2&gt;"));
        assert!(svg.contains("t / s") && svg.contains("tau / N·m"));
        assert!(!svg.contains("var(") && svg.contains("#D9660A"));
    }
}
