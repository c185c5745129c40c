use std::f64::consts::TAU;

use super::*;
use crate::optics::MountedCamera;
use crate::panorama::PanoramaGeometry;

const WIDTH: usize = 1080;

fn view() -> (Raster, View) {
    let camera = MountedCamera::reference(0.6);
    let geometry = PanoramaGeometry::for_camera(&camera).unwrap();
    let raster = Raster { width: geometry.width() as usize, height: geometry.height() as usize, wraps: true };
    assert_eq!(raster.width, WIDTH);
    (raster, View::panorama(geometry, &camera))
}

/// Paints a dark board on a bright wall: from one column to another (fractions are mixed, columns run over the seam, each row
/// `slant` further than the one above) in some rows.
fn board(picture: &mut [u8], raster: &Raster, columns: [f64; 2], rows: std::ops::Range<usize>, slant: f64) {
    for row in rows.clone() {
        let [left, right] = columns.map(|c| c + slant * (row - rows.start) as f64);
        for x in left.floor() as isize..=right.ceil() as isize {
            // Pixel x reaches from x − ½ to x + ½.
            let share = ((x as f64 + 0.5).min(right) - (x as f64 - 0.5).max(left)).clamp(0.0, 1.0);
            let at = row * raster.width + x.rem_euclid(raster.width as isize) as usize;
            picture[at] = (f64::from(picture[at]) * (1.0 - share) + 60.0 * share).round() as u8;
        }
    }
}

#[test]
fn an_upright_edge_is_where_it_is_to_a_tenth_of_a_column_with_its_levels_and_ends() {
    let (raster, view) = view();
    let mut picture = vec![160u8; raster.len()];
    // Over the seam, cut by the picture's lower end.
    board(&mut picture, &raster, [1070.3, 1100.8], 40..raster.height, 0.0);
    // Slanting: a chair's back, an edge of a table.
    board(&mut picture, &raster, [400.0, 440.0], 30..120, 0.08);
    let edges = upright_edges(&picture, &vec![1; raster.len()], &raster, &view, &[]);
    assert_eq!(edges.len(), 2, "{edges:?}");
    for (column, levels) in [(1070.3, [160, 60]), (1100.8, [60, 160])] {
        let (bearing, highest) = view.angles_rad(column, 40.0).unwrap();
        let off = |e: &UprightEdge| difference(e.bearing.rad(), bearing);
        let edge = edges.iter().min_by(|a, b| off(a).abs().total_cmp(&off(b).abs())).unwrap();
        let columns = off(edge) / TAU * WIDTH as f64;
        assert!(columns.abs() < 0.1, "{columns}");
        assert!(off(edge).abs() < 3.0 * edge.sigma.value());
        assert_eq!(edge.levels, levels);
        assert_eq!(edge.ends, [false, true]);
        assert!((edge.elevation[1].rad() - highest).abs() < 2.0 * view.steps_rad(0.0, 40.0)[1], "{edge:?}");
    }
}

#[test]
fn robots_and_what_the_camera_does_not_see_have_no_edges() {
    let (raster, view) = view();
    let mut picture = vec![160u8; raster.len()];
    board(&mut picture, &raster, [200.0, 230.0], 20..140, 0.0);
    board(&mut picture, &raster, [600.0, 640.0], 20..140, 0.0);
    let mut valid = vec![1; raster.len()];
    for row in valid.chunks_exact_mut(raster.width) {
        row[190..240].fill(0);
    }
    let (bearing_rad, _) = view.angles_rad(620.0, 80.0).unwrap();
    let fellow = PeerBearing { bearing_rad, half_width_rad: 0.12 };
    assert_eq!(upright_edges(&picture, &valid, &raster, &view, &[]).len(), 2);
    assert_eq!(upright_edges(&picture, &valid, &raster, &view, &[fellow]), []);
}

#[test]
fn edges_are_told_when_the_background_has_settled_and_seldom_again() {
    let mut due = Due::default();
    let told = |due: &mut Due, from: f64, until: f64, ready: bool| -> Vec<f64> {
        let frames = (0..((until - from) * 10.0).round() as usize).map(|k| from + 0.1 * k as f64);
        frames.filter(|t| due.is_due(Timestamp::from_secs_f64(1000.0 + t), ready)).collect()
    };
    assert_eq!(told(&mut due, 0.0, 5.0, false), [0.0; 0]);
    let times = told(&mut due, 5.0, 30.0, true);
    assert_eq!(times.iter().map(|t| t.round()).collect::<Vec<_>>(), [8.0, 18.0, 28.0]);
    assert_eq!(told(&mut due, 30.0, 31.0, false), [0.0; 0]);
    assert_eq!(told(&mut due, 31.0, 33.5, true), [0.0; 0], "it stands anew");
    assert_eq!(told(&mut due, -90.0, -88.0, true).len(), 1, "the clock was set back");
}
