//! The plots, each an SVG of its own.

use nalgebra::Vector2;
use plotters::coord::Shift;
use plotters::prelude::*;

use crate::calibration::summary::Summary;

type Plot = Result<String, Box<dyn std::error::Error>>;
/// Name, colour, points.
type Curve<'a> = (&'a str, RGBColor, Vec<(f64, f64)>);
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

const SIZE: (u32, u32) = (600, 420);
const FONT: (&str, i32) = ("sans-serif", 14);
const BLUE_LINE: RGBColor = RGBColor(42, 111, 176);
const RED_LINE: RGBColor = RGBColor(196, 60, 50);

fn drawn(size: (u32, u32), draw: impl Fn(&Area) -> Result<(), Box<dyn std::error::Error>>) -> Plot {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        area.fill(&WHITE)?;
        draw(&area)?;
        area.present()?;
    }
    Ok(svg)
}

/// All measured points with their residuals.
fn residuals<'a>(summary: &'a Summary) -> impl Iterator<Item = (Vector2<f64>, Vector2<f64>)> + 'a {
    let views = summary.observations.views.iter().zip(&summary.best().fit.residuals_px);
    views.flat_map(|(view, residuals)| view.points.iter().zip(residuals).map(|((_, pixel), r)| (*pixel, *r)))
}

/// The picture's shape, as large as a plot is.
fn picture_size(summary: &Summary) -> (u32, u32) {
    let [w, h] = summary.observations.image_size_px;
    (SIZE.0, (SIZE.0 - 60) * h / w.max(1) + 50)
}

fn mean_length(summary: &Summary) -> f64 {
    summary.best().fit.mean_px().max(1e-6)
}

/// Residual vectors, enlarged, over the picture.
pub(super) fn residual_vectors(summary: &Summary) -> Plot {
    let [w, h] = summary.observations.image_size_px.map(f64::from);
    // A mean residual is drawn as long as a fiftieth of the picture.
    let scale = round_down(w / 50.0 / mean_length(summary));
    drawn(picture_size(summary), |area| {
        let mut chart = ChartBuilder::on(area)
            .caption(format!("enlarged {scale} times"), FONT)
            .margin(8)
            .x_label_area_size(24)
            .y_label_area_size(40)
            .build_cartesian_2d(0.0..w, h..0.0)?;
        chart.configure_mesh().disable_mesh().draw()?;
        for (pixel, residual) in residuals(summary) {
            let end = pixel + residual * scale;
            chart.draw_series([PathElement::new(vec![(pixel.x, pixel.y), (end.x, end.y)], RED_LINE)])?;
            chart.draw_series([Circle::new((pixel.x, pixel.y), 1, BLUE_LINE.filled())])?;
        }
        Ok(())
    })
}

/// 1, 2 or 5 times a power of ten, not above the value.
fn round_down(value: f64) -> f64 {
    let power = 10_f64.powf(value.max(1e-9).log10().floor());
    let digit = value / power;
    power
        * if digit >= 5.0 {
            5.0
        } else if digit >= 2.0 {
            2.0
        } else {
            1.0
        }
}

/// The radial part of each residual against the distance from the centre.
pub(super) fn residuals_by_radius(summary: &Summary) -> Plot {
    let centre = summary.centre_px();
    let points: Vec<(f64, f64)> = residuals(summary)
        .filter_map(|(pixel, r)| {
            let out = pixel - centre;
            (out.norm() > 0.0).then(|| (out.norm(), r.dot(&out) / out.norm()))
        })
        .collect();
    let far = points.iter().map(|p| p.0).fold(1.0, f64::max) * 1.05;
    // Outliers do not set the scale.
    let limit = 6.0 * mean_length(summary);
    drawn(SIZE, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..far, -limit..limit)?;
        chart.configure_mesh().x_desc("radius, px").y_desc("radial residual, px").draw()?;
        let dots =
            points.iter().map(|(r, e)| Circle::new((*r, e.clamp(-limit, limit)), 2, BLUE_LINE.mix(0.4).filled()));
        chart.draw_series(dots)?;
        chart.draw_series([PathElement::new(vec![(0.0, 0.0), (far, 0.0)], BLACK)])?;
        Ok(())
    })
}

/// How many points each part of the picture has.
pub(super) fn coverage(summary: &Summary) -> Plot {
    let cells = summary.coverage();
    let most = cells.iter().flatten().copied().max().unwrap_or(0).max(1) as f64;
    let [w, h] = summary.observations.image_size_px.map(f64::from);
    drawn(picture_size(summary), |area| {
        let mut chart = ChartBuilder::on(area)
            .caption("points in each cell", FONT)
            .margin(8)
            .x_label_area_size(24)
            .y_label_area_size(40)
            .build_cartesian_2d(0.0..w, h..0.0)?;
        chart.configure_mesh().disable_mesh().draw()?;
        let (rows, cols) = (cells.len() as f64, cells.first().map_or(1, Vec::len) as f64);
        for (j, row) in cells.iter().enumerate() {
            for (i, count) in row.iter().enumerate() {
                let (x, y) = (i as f64 * w / cols, j as f64 * h / rows);
                let shade = (*count as f64 / most).sqrt();
                let cell = [(x, y), (x + w / cols, y + h / rows)];
                chart.draw_series([Rectangle::new(cell, BLUE_LINE.mix(shade).filled())])?;
                if *count > 0 {
                    let at = (x + 0.3 * w / cols, y + 0.35 * h / rows);
                    chart.draw_series([Text::new(count.to_string(), at, ("sans-serif", 11))])?;
                }
            }
        }
        Ok(())
    })
}

/// Pixels per degree of elevation.
pub(super) fn resolution(summary: &Summary) -> Plot {
    let points: Vec<(f64, f64)> =
        summary.rays().iter().map(|r| (r.elevation_rad.to_degrees(), r.px_per_rad.to_radians())).collect();
    curves("elevation in the camera's frame, °", "px per degree", &[("", BLUE_LINE, points)])
}

/// Sigmas of bearing and elevation.
pub(super) fn ray_sigmas(summary: &Summary) -> Plot {
    let rays = summary.rays();
    let curve = |f: fn(&crate::calibration::summary::RaySigma) -> f64| {
        rays.iter().map(|r| (r.elevation_rad.to_degrees(), f(r).to_degrees())).collect::<Vec<_>>()
    };
    // Near the axis a bearing says nothing: its sigma does not set the scale.
    let elevation = curve(|r| r.elevation_sigma_rad);
    let limit = 5.0 * elevation.iter().map(|p| p.1).fold(0.0, f64::max);
    let bearing = curve(|r| r.bearing_sigma_rad).into_iter().filter(|p| p.1 <= limit).collect();
    let list = [("bearing", RED_LINE, bearing), ("elevation", BLUE_LINE, elevation)];
    curves("elevation in the camera's frame, °", "one sigma, °", &list)
}

fn curves(x: &str, y: &str, list: &[Curve]) -> Plot {
    let all = || list.iter().flat_map(|(_, _, points)| points.iter());
    if all().next().is_none() {
        return drawn(SIZE, |area| {
            area.draw(&Text::new("not determined by this data", (40, 40), FONT))?;
            Ok(())
        });
    }
    let (low, high) = all().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p.0), h.max(p.0)));
    let top = 1.1 * all().map(|p| p.1).fold(1e-12, f64::max);
    drawn(SIZE, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(60)
            .build_cartesian_2d(low..high, 0.0..top)?;
        chart.configure_mesh().x_desc(x).y_desc(y).draw()?;
        for (name, colour, points) in list {
            let colour = *colour;
            let series = chart.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?;
            if !name.is_empty() {
                series
                    .label(*name)
                    .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 20, y)], colour.stroke_width(2)));
            }
        }
        if list.iter().any(|(name, ..)| !name.is_empty()) {
            chart.configure_series_labels().border_style(BLACK).background_style(WHITE).label_font(FONT).draw()?;
        }
        Ok(())
    })
}

/// Rms of each view.
pub(super) fn views(summary: &Summary) -> Plot {
    let values: Vec<f64> = summary
        .best()
        .fit
        .residuals_px
        .iter()
        .map(|r| (r.iter().map(Vector2::norm_squared).sum::<f64>() / r.len().max(1) as f64).sqrt())
        .collect();
    let top = 1.1 * values.iter().copied().fold(1e-9, f64::max);
    let names: Vec<&str> = summary.observations.views.iter().map(|v| v.name.as_str()).collect();
    drawn(SIZE, |area| {
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..values.len() as f64, 0.0..top)?;
        chart.configure_mesh().disable_x_mesh().disable_x_axis().y_desc("rms, px").draw()?;
        for (i, value) in values.iter().enumerate() {
            let bar = [(i as f64 + 0.1, 0.0), (i as f64 + 0.9, *value)];
            chart.draw_series([Rectangle::new(bar, BLUE_LINE.mix(0.7).filled())])?;
            let name = names[i].trim_end_matches(".jpg").trim_end_matches(".png");
            let short: String = name.chars().skip(name.chars().count().saturating_sub(5)).collect();
            chart.draw_series([Text::new(short, (i as f64 + 0.15, 0.04 * top), ("sans-serif", 11))])?;
        }
        Ok(())
    })
}
