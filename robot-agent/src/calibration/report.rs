//! The calibration's report: one page for people with plots in it, and the same as JSON beside it.

mod plots;

use std::fmt::Write;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::summary::Summary;

/// Why no report was written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A file cannot be written.
    #[error("{path}: cannot be written: {source}", path = path.display())]
    Unwritable {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A plot failed.
    #[error("a plot of the report failed: {0}")]
    Plot(String),
}

/// Last line of a page.
const TO_NUMBERS: &str = "<p>The same numbers for programs: <a href=\"report.json\">report.json</a></p>";

/// Writes `index.html` and `report.json` into a folder, which is made where it does not exist.
///
/// # Errors
/// The folder or a file cannot be written.
pub fn write(summary: &Summary, folder: &Path) -> Result<(), ReportError> {
    save(folder, page(summary)?, &summary.json())
}

/// The same of a calibration that is told in words and numbers alone.
///
/// # Errors
/// The folder cannot be written.
pub fn write_findings(title: &str, words: &[String], numbers: &Value, folder: &Path) -> Result<(), ReportError> {
    let page = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Calibration: {title}</title><style>{STYLE}</style>\
         <h1>Calibration: {title}</h1><ul class=\"verdict\">{}</ul>{TO_NUMBERS}</html>\n",
        list(words),
        title = escaped(title),
    );
    save(folder, page, numbers)
}

fn save(folder: &Path, page: String, numbers: &Value) -> Result<(), ReportError> {
    std::fs::create_dir_all(folder).map_err(|source| ReportError::Unwritable { path: folder.into(), source })?;
    let save = |name: &str, text: String| {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(|source| ReportError::Unwritable { path, source })
    };
    save("index.html", page)?;
    save("report.json", format!("{numbers:#}\n"))
}

fn list(words: &[String]) -> String {
    words.iter().fold(String::new(), |mut all, line| {
        let _ = write!(all, "<li>{}</li>", escaped(line));
        all
    })
}

fn page(summary: &Summary) -> Result<String, ReportError> {
    let plots = [
        ("Residuals over the picture", plots::residual_vectors(summary)),
        ("Residuals by radius", plots::residuals_by_radius(summary)),
        ("Where the points were", plots::coverage(summary)),
        ("Angular resolution by elevation", plots::resolution(summary)),
        ("Uncertainty of a ray by elevation", plots::ray_sigmas(summary)),
        ("Residual of each view", plots::views(summary)),
    ];
    let mut figures = String::new();
    for (title, plot) in plots {
        let svg = plot.map_err(|e| ReportError::Plot(format!("{title}: {e}")))?;
        let _ = write!(figures, "<figure><figcaption>{title}</figcaption>{svg}</figure>");
    }
    Ok(format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Calibration: {title}</title><style>{STYLE}</style>\
         <h1>Calibration: {title}</h1><ul class=\"verdict\">{words}</ul>{unknowns}{candidates}<div class=\"plots\">{figures}</div>\
         {TO_NUMBERS}</html>\n",
        words = list(&summary.words()),
        title = escaped(&summary.best().name),
        unknowns = unknowns(summary),
        candidates = candidates(summary),
    ))
}

fn unknowns(summary: &Summary) -> String {
    let camera = &summary.best().fit.camera;
    let mut rows = String::new();
    for (i, (unknown, value)) in camera.unknowns().iter().zip(camera.unknown_values()).enumerate() {
        let sigma = summary.covariance.as_ref().map_or("not determined".into(), |c| number(c.sigma(i)));
        let (name, unit) = (escaped(&unknown.name), super::bundle::unit(&unknown.name));
        let _ = write!(rows, "<tr><td>{name}<td>{}<td>± {sigma}<td>{unit}</tr>", number(value));
    }
    format!("<table><tr><th>parameter<th>value<th>one sigma<th>unit</tr>{rows}</table>")
}

fn candidates(summary: &Summary) -> String {
    let mut rows = String::new();
    for (i, j) in summary.selection.judged.iter().enumerate() {
        let class = if i == summary.selection.chosen { " class=\"chosen\"" } else { "" };
        let unseen = j.unseen_rms_px.map_or("–".into(), |rms| format!("{rms:.3}"));
        let _ = write!(
            rows,
            "<tr{class}><td>{}<td>{}<td>{:.3}<td>{unseen}<td>{:.0}</tr>",
            escaped(&j.name),
            j.fit.camera.unknowns().len(),
            j.fit.rms_px(),
            j.information_criterion
        );
    }
    for (name, error) in &summary.selection.failed {
        let _ = write!(rows, "<tr><td>{}<td colspan=\"4\">{}</tr>", escaped(name), escaped(&error.to_string()));
    }
    format!(
        "<table><tr><th>model<th>unknowns<th>rms, px<th>rms on unseen views, px<th>information criterion</tr>{rows}</table>"
    )
}

/// Five significant digits, whatever the size.
fn number(value: f64) -> String {
    let digits = if value == 0.0 { 0.0 } else { value.abs().log10().floor() };
    if (-4.0..6.0).contains(&digits) {
        format!("{value:.*}", (4.0 - digits).clamp(0.0, 8.0) as usize)
    } else {
        format!("{value:.4e}")
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

const STYLE: &str = "body{font:16px/1.5 sans-serif;max-width:1240px;margin:2em auto;padding:0 1em;color:#222}\
    ul.verdict{background:#f2f6fa;border-left:4px solid #2a6fb0;padding:.8em 1em .8em 2em}\
    table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .8em;border-bottom:1px solid #ddd;text-align:left}\
    tr.chosen{background:#e6f4e6;font-weight:600}.plots{display:flex;flex-wrap:wrap;gap:1em}\
    figure{margin:0}figcaption{font-weight:600}svg{max-width:100%;height:auto}";
