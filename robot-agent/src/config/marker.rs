//! The marker in the configuration: given in place or by a file, and plausible. A length in the wrong unit is the error to
//! catch here: it would put every range out by the same factor, and no covariance would tell.

use protocol::document::{Document, DocumentError};
use protocol::marker::{Look, Marker};

use super::raw::RawRobot;

/// The robot's marker.
pub fn checked(document: &Document, robot: &RawRobot) -> Result<Marker, DocumentError> {
    match (&robot.marker, &robot.marker_file) {
        (Some(marker), None) => {
            check(document, "robot.marker.", marker)?;
            Ok(marker.clone())
        }
        (None, Some(file)) => {
            let document = Document::read(&document.resolve(file))?;
            let marker: Marker = document.parse()?;
            check(&document, "", &marker)?;
            Ok(marker)
        }
        (Some(_), Some(file)) => {
            let wanted = "give either `marker` or `marker_file`, not both";
            Err(document.invalid("robot.marker_file", file.display(), wanted))
        }
        (None, None) => {
            let wanted = "say what the others see of this robot: marker = { kind = \"cylinder\", radius_m = 0.2, height_m = \
                          [0.1, 0.5], look = { rings = [..] } }, or marker_file = \"marker.toml\"";
            Err(document.invalid("robot.marker", "missing", wanted))
        }
    }
}

fn check(document: &Document, at: &str, marker: &Marker) -> Result<(), DocumentError> {
    let length = |key: &str, value: f64, low: f64, high: f64| {
        if (low..=high).contains(&value) {
            return Ok(());
        }
        Err(document.invalid(&format!("{at}{key}"), value, format!("metres between {low} and {high}")))
    };
    let interval = |[low, high]: [f64; 2], look: Option<&Look>| {
        length("height_m", low, 0.0, 5.0)?;
        length("height_m", high, 0.0, 5.0)?;
        if low >= high {
            let key = format!("{at}height_m");
            return Err(document.invalid(&key, format!("[{low}, {high}]"), "the lower end first, then the upper"));
        }
        look.map_or(Ok(()), |look| rings(document, at, look, [low, high]))
    };
    if let Some((beacon, Err(fault))) = marker.beacon().map(|beacon| (beacon, beacon.validate())) {
        return Err(document.invalid(&format!("{at}look.beacon"), format!("{beacon:?}"), fault.to_string()));
    }
    match marker {
        Marker::Cylinder { radius_m, height_m, look } => {
            length("radius_m", *radius_m, 0.01, 2.0)?;
            interval(*height_m, look.as_ref())
        }
        Marker::Bars { radius_m, height_m, look, .. } => {
            length("radius_m", *radius_m, 0.01, 2.0)?;
            interval(*height_m, look.as_ref())
        }
        Marker::Rectangle { width_m, height_m, left_edge_m, behind_m, bottom_m, .. } => {
            length("width_m", *width_m, 0.01, 5.0)?;
            length("height_m", *height_m, 0.01, 5.0)?;
            length("left_edge_m", *left_edge_m, -5.0, 5.0)?;
            length("behind_m", *behind_m, -5.0, 5.0)?;
            length("bottom_m", *bottom_m, 0.0, 5.0)
        }
    }
}

fn rings(document: &Document, at: &str, look: &Look, [low, high]: [f64; 2]) -> Result<(), DocumentError> {
    const SLACK_M: f64 = 1e-6;
    let key = format!("{at}look");
    let mut edge = low;
    for ring in &look.rings {
        let [bottom, top] = ring.height_m;
        if (bottom - edge).abs() > SLACK_M || top <= bottom {
            let wanted = format!("rings go without gaps from the lower to the upper end; the next begins at {edge} m");
            return Err(document.invalid(&key, format!("a ring from {bottom} to {top} m"), wanted));
        }
        if !(0.0..=1.0).contains(&ring.reflectance) {
            return Err(document.invalid(&key, format!("reflectance {}", ring.reflectance), "0 (black) to 1 (white)"));
        }
        edge = top;
    }
    if (edge - high).abs() > SLACK_M {
        let wanted = format!("the rings end where the marker does, at {high} m");
        return Err(document.invalid(&key, format!("rings up to {edge} m"), wanted));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn a_marker_file_is_checked_as_one_in_place() {
        let folder = tempfile::tempdir().unwrap();
        let write = |text: &str| std::fs::write(folder.path().join("marker.toml"), text).unwrap();
        write("kind = 'cylinder'\nradius_m = 0.2\n[look]\nrings = [{ height_m = [0.1, 0.5], reflectance = 0.9 }]\n");
        assert!(matches!(read(folder.path()), Ok(Marker::Cylinder { look: Some(_), .. })));
        write("kind = 'cylinder'\nradius_m = 20.0\n");
        let message = read(folder.path()).unwrap_err().to_string();
        assert!(message.contains("marker.toml:2") && message.contains("metres between"), "{message}");
        write("kind = 'cylinder'\nradius_m = 0.2\n[look]\nrings = [{ height_m = [0.1, 0.4], reflectance = 0.9 }]\n");
        let message = read(folder.path()).unwrap_err().to_string();
        assert!(message.contains("rings up to 0.4 m") && message.contains("at 0.5 m"), "{message}");
        write("kind = 'cylinder'\nradius_m = 0.2\n[look]\nrings = [{ height_m = [0.1, 0.5], reflectance = 90.0 }]\n");
        assert!(read(folder.path()).unwrap_err().to_string().contains("0 (black) to 1 (white)"));
        for (beacon, wrong) in [
            ("height_mm = 540, code = '1111', bit_ms = 200", "never changes"),
            ("height_mm = 540, code = '10x0', bit_ms = 200", "else than 0 and 1"),
            ("height_mm = 540, code = '101', bit_ms = 200", "code (its length) is 3"),
            ("height_mm = 540, code = '1010', bit_ms = 5", "bit_ms is 5"),
            ("height_mm = 540, code = '10100', bit_ms = 2000", "is 10; legal is 0 to 8"),
        ] {
            write(&format!("kind = 'cylinder'\nradius_m = 0.2\nlook = {{ rings = [], beacon = {{ {beacon} }} }}\n"));
            let message = read(folder.path()).unwrap_err().to_string();
            assert!(message.contains("look.beacon") && message.contains(wrong), "{message}");
        }
    }

    #[test]
    fn no_marker_at_all_is_told_what_one_looks_like() {
        let robot = RawRobot { marker_file: None, ..robot() };
        let message = checked(&document(Path::new("")), &robot).unwrap_err().to_string();
        assert!(message.contains("kind = \"cylinder\""), "{message}");
    }

    fn read(folder: &Path) -> Result<Marker, DocumentError> {
        checked(&document(folder), &robot())
    }

    fn robot() -> RawRobot {
        RawRobot {
            state_dir: None,
            id: String::new(),
            team: String::new(),
            camera: "camera.toml".into(),
            marker: None,
            marker_file: Some("marker.toml".into()),
            host: None,
        }
    }

    fn document(folder: &Path) -> Document {
        Document::from_text(&folder.join("agent.toml"), String::new())
    }
}
