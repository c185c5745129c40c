//! The outcome as a picture: RMSE over the bound, and NEES, over how exact the bound is.

use std::path::Path;

use plotters::prelude::*;

use super::trial::{LINEAR_BELOW, Outcome};

type Drawn = Result<(), Box<dyn std::error::Error>>;

const SIZE: (u32, u32) = (1100, 900);
const COLOURS: [RGBColor; 9] = [
    RGBColor(31, 119, 180),
    RGBColor(255, 127, 14),
    RGBColor(44, 160, 44),
    RGBColor(214, 39, 40),
    RGBColor(148, 103, 189),
    RGBColor(140, 86, 75),
    RGBColor(227, 119, 194),
    RGBColor(23, 190, 207),
    RGBColor(90, 90, 90),
];

/// Writes it as SVG.
pub fn write(outcomes: &[Outcome], path: &Path) -> Drawn {
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let (upper, lower) = root.split_vertically(SIZE.1 / 2);
    let groups = groups(outcomes);
    panel(&upper, "largest RMSE over the Cramér–Rao bound", &groups, |o| o.to_bound.largest(), &[1.0, 1.05])?;
    panel(&lower, "NEES of the robots over its degrees of freedom", &groups, |o| o.nees_robots.mean, &[1.0])?;
    root.present()?;
    Ok(())
}

type Group<'a> = (String, Vec<&'a Outcome>);

fn groups(outcomes: &[Outcome]) -> Vec<Group<'_>> {
    let mut groups: Vec<Group<'_>> = Vec::new();
    for o in outcomes {
        let name = if o.robots == 2 { format!("2 robots, {}", o.marker) } else { format!("{} robots", o.robots) };
        match groups.iter_mut().find(|(n, _)| *n == name) {
            Some((_, of)) => of.push(o),
            None => groups.push((name, vec![o])),
        }
    }
    groups
}

fn panel(
    area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    title: &str,
    groups: &[Group<'_>],
    value: impl Fn(&Outcome) -> f64,
    lines: &[f64],
) -> Drawn {
    let all = || groups.iter().flat_map(|(_, of)| of.iter());
    let low = all().map(|o| o.relative_bound).fold(f64::INFINITY, f64::min).max(1e-5) * 0.8;
    let high = all().map(|o| o.relative_bound).fold(LINEAR_BELOW, f64::max) * 1.3;
    let values = || all().map(|o| value(o)).filter(|v| v.is_finite());
    let (bottom, top) = (values().fold(0.97, f64::min) - 0.01, values().fold(1.06, f64::max).min(2.0) + 0.02);
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(38)
        .y_label_area_size(52)
        .build_cartesian_2d((low..high).log_scale(), bottom..top)?;
    chart.configure_mesh().x_desc("bound of the baseline over the baseline").light_line_style(WHITE).draw()?;
    for y in lines {
        chart.draw_series(LineSeries::new([(low, *y), (high, *y)], BLACK.mix(0.6)))?;
    }
    chart.draw_series(LineSeries::new([(LINEAR_BELOW, bottom), (LINEAR_BELOW, top)], BLACK.mix(0.3)))?;
    for ((name, of), colour) in groups.iter().zip(COLOURS.iter().cycle()) {
        let points = of.iter().map(|o| Circle::new((o.relative_bound, value(o).min(top)), 3, colour.filled()));
        chart.draw_series(points)?.label(name).legend(|(x, y)| Circle::new((x + 6, y), 4, colour.filled()));
    }
    chart.configure_series_labels().position(SeriesLabelPosition::UpperLeft).background_style(WHITE.mix(0.8)).draw()?;
    Ok(())
}
