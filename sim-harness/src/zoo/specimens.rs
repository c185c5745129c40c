//! The cameras of the zoo. Their lengths stand once; the table of `camera.toml` and the optical bench are both made from
//! them.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::LazyLock;

use nalgebra::Vector3;

use super::Specimen;
use crate::render::bench::{Bench, Element, Eye, OutwardRay};
use crate::render::surface::{Quadric, reflect};

type V = Vector3<f64>;

const SIZE: [u32; 2] = [768, 576];
const CENTRE: [f64; 2] = [383.5, 287.5];
const EVERYWHERE: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// Every camera model, some of them twice.
pub fn specimens() -> &'static [Specimen] {
    static ALL: LazyLock<Vec<Specimen>> = LazyLock::new(all);
    &ALL
}

fn all() -> Vec<Specimen> {
    vec![
        pal("pal", 1.5168, [-15.0, 20.0]),
        pal("pal-without-refraction", 1.0, [4.5, 32.0]),
        pal_orthographic(),
        pal_single_viewpoint(),
        pal_of_spheres(),
        pal_with_flat_face(),
        hyperboloidal("hyperboloidal", "below"),
        hyperboloidal("hyperboloidal-from-above", "above"),
        paraboloidal(),
        ellipsoidal(),
        spherical(),
        conic(),
        pyramid(),
        fisheye("equidistant", 180.0, |theta| theta, PI),
        fisheye("stereographic", 140.0, |theta| 2.0 * (0.5 * theta).tan(), 3.1),
        fisheye("equisolid", 200.0, |theta| 2.0 * (0.5 * theta).sin(), PI - 1e-3),
        fisheye("orthographic", 285.0, f64::sin, FRAC_PI_2 - 1e-3),
        fisheye("kannala-brandt", 180.0, |t| t + 0.02 * t.powi(3) - 0.005 * t.powi(5) + 0.0004 * t.powi(7), PI - 1e-3),
        unified_sphere(),
        polynomial(),
        mosaic(),
        pinhole(),
    ]
}

fn specimen(
    name: &'static str,
    model: &'static str,
    mut table: String,
    trace: impl Fn(f64, f64) -> Option<OutwardRay> + Send + Sync + 'static,
) -> Specimen {
    table.push_str(&format!("centre_px = {CENTRE:?}\n"));
    Specimen { name, model, size_px: SIZE, table, trace: Box::new(trace) }
}

fn bench(name: &'static str, model: &'static str, table: String, bench: Bench) -> Specimen {
    specimen(name, model, table, move |u, v| bench.trace(u, v))
}

/// Both mirrors of a PAL: (a_e, c_e), (a_h, c_h); V in the origin.
fn confocal([ae, ce]: [f64; 2], [ah, ch]: [f64; 2]) -> ([Element; 2], f64) {
    let second = Quadric::conic(2.0 * ce - ch, ah * ah, ch * ch - ah * ah, -1.0);
    let ring = Quadric::conic(ce, ae * ae, ae * ae - ce * ce, 1.0);
    let mirrors = [Element::Mirror(second, [2.0 * ce - ch, f64::INFINITY]), Element::Mirror(ring, EVERYWHERE)];
    (mirrors, 2.0 * ce - 2.0 * ch)
}

fn window(a: f64, e: f64, n: f64) -> Element {
    Element::Window(Quadric::conic(-a * e, a * a, a * a * (1.0 - e * e), 1.0), EVERYWHERE, n)
}

fn through_pinhole(z: f64, f: f64, elements: Vec<Element>) -> Bench {
    Bench { eye: Eye::Pinhole(z, f), looks_up: true, crosses: true, centre_px: CENTRE, elements }
}

const RING: [f64; 2] = [23.8095238095, 9.52380952381];
const SECOND: [f64; 2] = [6.47619047619, 16.5238095238];
const FOCAL_PX: f64 = 751.84954507;

fn pal(name: &'static str, n: f64, elevation_deg: [f64; 2]) -> Specimen {
    let (mirrors, pinhole) = confocal(RING, SECOND);
    let table = format!(
        "ellipsoid_a_mm = {}\nellipsoid_c_mm = {}\nhyperboloid_a_mm = {}\nhyperboloid_c_mm = {}\n\
         focal_length_px = {FOCAL_PX}\nrefraction_a_mm = 31.25\nrefraction_eccentricity = 0.6\nrefractive_index = {n:?}\n\
         elevation_deg = {elevation_deg:?}\n",
        RING[0], RING[1], SECOND[0], SECOND[1]
    );
    bench(name, "pal", table, through_pinhole(pinhole, FOCAL_PX, [&mirrors[..], &[window(31.25, 0.6, n)]].concat()))
}

fn pal_orthographic() -> Specimen {
    let (mirrors, _) = confocal(RING, SECOND);
    let (p, m) = (20.0, 28.0);
    // Round B, opening up: its vertex is half of p below.
    let vertex = 2.0 * RING[1] - 0.5 * p;
    let second = Element::Mirror(Quadric::paraboloid(vertex, -p), [vertex - 1e-9, f64::INFINITY]);
    let table = format!(
        "ellipsoid_a_mm = {}\nellipsoid_c_mm = {}\nparaboloid_p_mm = {p:?}\nmagnification_px_per_mm = {m:?}\n\
         refraction_a_mm = 31.25\nrefraction_eccentricity = 0.6\nrefractive_index = 1.5168\nelevation_deg = [-15.0, 20.0]\n",
        RING[0], RING[1]
    );
    let elements = vec![second, mirrors[1], window(31.25, 0.6, 1.5168)];
    let eye = Eye::Telecentric(-20.0, m);
    bench(
        "pal-orthographic",
        "pal-orthographic",
        table,
        Bench { eye, looks_up: true, crosses: true, centre_px: CENTRE, elements },
    )
}

fn pal_single_viewpoint() -> Specimen {
    let (ring, second) = ([21.978021978022, 6.59340659340659], [6.90659340659341, 13.5934065934066]);
    let (n, t, c, f) = (1.5168, 5.35898384862245, 9.63047639179834, 744.912451010028);
    let (mirrors, pinhole) = confocal(ring, second);
    let table = format!(
        "ellipsoid_a_mm = {}\nellipsoid_c_mm = {}\nhyperboloid_a_mm = {}\nhyperboloid_c_mm = {}\nfocal_length_px = {f}\n\
         refractive_index = {n}\noval_t_mm = {t}\noval_c_mm = {c}\nelevation_deg = [-15.0, 20.0]\n",
        ring[0], ring[1], second[0], second[1]
    );
    let elements = [&mirrors[..], &[Element::Oval { n, t, c }]].concat();
    bench("pal-single-viewpoint", "pal-single-viewpoint", table, through_pinhole(pinhole, f, elements))
}

/// Vertex heights and radii of the spheres that fit design D's mirrors, rounded as a workshop would have them.
fn pal_of_spheres() -> Specimen {
    let ([z1, r1], [z2, r2]) = ([-14.5, 21.3], [9.1, 45.0]);
    let table = format!(
        "first_mirror = [{z1:?}, {r1:?}, 0.0]\nsecond_mirror = [{z2:?}, {r2:?}, 0.0]\nwindow = [12.5, -20.0, -0.36]\n\
         pinhole_z_mm = -14.0\nfocal_length_px = {FOCAL_PX}\nrefractive_index = 1.5168\nelevation_deg = [-10.0, 15.0]\n"
    );
    let elements = vec![
        Element::Mirror(Quadric::sphere(z2 + r2, r2), EVERYWHERE),
        Element::Mirror(Quadric::sphere(z1 + r1, r1), [f64::NEG_INFINITY, z1 + r1]),
        window(31.25, 0.6, 1.5168),
    ];
    bench("pal-of-spheres", "pal-conicoid", table, through_pinhole(-14.0, FOCAL_PX, elements))
}

fn pal_with_flat_face() -> Specimen {
    let (mirrors, _) = confocal(RING, SECOND);
    let (n, face, pinhole, f) = (1.5168, -9.0, -12.11, 495.6813);
    let conicoid = |[a, c]: [f64; 2]| ((a * a - c * c).abs() / a, -(c / a) * (c / a));
    let ((p1, k1), (p2, k2)) = (conicoid(RING), conicoid(SECOND));
    let table = format!(
        "first_mirror = [{:?}, {p1:?}, {k1:?}]\nsecond_mirror = [{:?}, {p2:?}, {k2:?}]\nwindow = [12.5, -20.0, -0.36]\n\
         pinhole_z_mm = {pinhole:?}\nface_z_mm = {face:?}\nfocal_length_px = {f:?}\nrefractive_index = {n}\n\
         elevation_deg = [-14.0, 18.0]\n",
        RING[1] - RING[0],
        2.0 * RING[1] - SECOND[1] + SECOND[0]
    );
    let into_glass = Element::Window(Quadric::plane(face), EVERYWHERE, 1.0 / n);
    let elements = [&[into_glass], &mirrors[..], &[window(31.25, 0.6, n)]].concat();
    bench("pal-with-flat-face", "pal-conicoid", table, through_pinhole(pinhole, f, elements))
}

/// A mirror and the camera on one side of it. Above: the lengths as they are; below: everything with −z.
fn over_mirror(side: &str, eye: Eye, mirror: Quadric, [low, high]: [f64; 2], crosses: bool) -> Bench {
    let below = side == "below";
    let (eye, mirror, heights) = if below {
        let eye = match eye {
            Eye::Pinhole(z, f) => Eye::Pinhole(-z, f),
            Eye::Telecentric(z, m) => Eye::Telecentric(-z, m),
        };
        (eye, Quadric { b: -mirror.b, ..mirror }, [-high, -low])
    } else {
        (eye, mirror, [low, high])
    };
    Bench { eye, looks_up: below, crosses, centre_px: CENTRE, elements: vec![Element::Mirror(mirror, heights)] }
}

fn hyperboloidal(name: &'static str, side: &str) -> Specimen {
    let (a, c, f) = (28.0955, 38.658, 600.0);
    let table = format!("a_mm = {a}\nc_mm = {c}\nfocal_length_px = {f:?}\ncamera = \"{side}\"\n");
    // The lower sheet, round V.
    let mirror = Quadric::conic(c, a * a, c * c - a * a, -1.0);
    let eye = Eye::Pinhole(2.0 * c, f);
    bench(name, "hyperboloidal", table, over_mirror(side, eye, mirror, [f64::NEG_INFINITY, c], false))
}

fn paraboloidal() -> Specimen {
    let (p, m, side) = (30.0, 6.5, "below");
    let table = format!("p_mm = {p:?}\nmagnification_px_per_mm = {m:?}\ncamera = \"{side}\"\n");
    let mirror = Quadric::paraboloid(0.5 * p, p);
    let eye = Eye::Telecentric(100.0, m);
    bench("paraboloidal", "paraboloidal", table, over_mirror(side, eye, mirror, EVERYWHERE, false))
}

fn ellipsoidal() -> Specimen {
    let (a, c, f, side) = (60.0, 30.0, 420.0, "below");
    let table = format!("a_mm = {a:?}\nc_mm = {c:?}\nfocal_length_px = {f:?}\ncamera = \"{side}\"\n");
    let mirror = Quadric::conic(c, a * a, a * a - c * c, 1.0);
    let eye = Eye::Pinhole(2.0 * c, f);
    // Light meets in V before the mirror.
    bench("ellipsoidal", "ellipsoidal", table, over_mirror(side, eye, mirror, EVERYWHERE, true))
}

fn spherical() -> Specimen {
    let (rho, h, f, side) = (40.0, 120.0, 780.0, "below");
    let table = format!("rho_mm = {rho:?}\nh_mm = {h:?}\nfocal_length_px = {f:?}\ncamera = \"{side}\"\n");
    let eye = Eye::Pinhole(h, f);
    bench("spherical", "spherical", table, over_mirror(side, eye, Quadric::sphere(0.0, rho), EVERYWHERE, false))
}

fn conic() -> Specimen {
    let (gamma_deg, h, f, side) = (55.0_f64, 80.0, 420.0, "below");
    let table = format!("gamma_deg = {gamma_deg:?}\nh_mm = {h:?}\nfocal_length_px = {f:?}\ncamera = \"{side}\"\n");
    let (mirror, eye) = (Quadric::cone(gamma_deg.to_radians()), Eye::Pinhole(h, f));
    bench("conic", "conic", table, over_mirror(side, eye, mirror, [f64::NEG_INFINITY, 0.0], false))
}

fn pyramid() -> Specimen {
    let (h, f, size, centre) = (60.0, 150.0, [1024, 304], [127.5, 151.5]);
    let trace = move |u: f64, v: f64| {
        let quarter = f64::from(size[0]) / 4.0;
        let number = ((u + 0.5) / quarter).floor().clamp(0.0, 3.0);
        let (sin, cos) = (number * FRAC_PI_2).sin_cos();
        let (out, across) = (V::new(cos, sin, 0.0), V::new(-sin, cos, 0.0));
        // A real camera at its place, looking down on its face of the pyramid, whose apex is in the origin.
        let camera = out * h;
        let d = (out * (u - number * quarter - centre[0]) + across * (v - centre[1]) - V::z() * f).normalize();
        let normal = (out + V::z()).normalize();
        let t = -camera.dot(&normal) / d.dot(&normal);
        let at = camera + d * t;
        // On the face: below the apex and nearer to this camera than to its neighbours.
        (t > 0.0 && at.z < 0.0 && at.dot(&across).abs() <= at.dot(&out)).then_some(())?;
        Some(OutwardRay { origin_mm: at + V::z() * h, direction: reflect(&d, &normal) })
    };
    Specimen {
        name: "pyramid",
        model: "pyramid",
        size_px: size,
        table: format!("h_mm = {h:?}\nfocal_length_px = {f:?}\ncentre_px = {centre:?}\n"),
        trace: Box::new(trace),
    }
}

/// From the angle off the axis and the direction in the picture; the camera looks up.
fn looking_up(theta: f64, x: f64, y: f64) -> OutwardRay {
    let (sin, cos) = theta.sin_cos();
    let r = x.hypot(y).max(1e-300);
    OutwardRay { origin_mm: V::zeros(), direction: V::new(sin * x / r, sin * y / r, cos) }
}

fn fisheye(law: &'static str, f: f64, radius: fn(f64) -> f64, limit: f64) -> Specimen {
    let k = if law == "kannala-brandt" { "k = [0.02, -0.005, 0.0004, 0.0]\n" } else { "" };
    let table = format!("law = \"{law}\"\nfocal_length_px = {f:?}\n{k}");
    let name = match law {
        "equidistant" => "fisheye-equidistant",
        "stereographic" => "fisheye-stereographic",
        "equisolid" => "fisheye-equisolid",
        "orthographic" => "fisheye-orthographic",
        _ => "fisheye-kannala-brandt",
    };
    specimen(name, "fisheye", table, move |u, v| {
        let (x, y) = (u - CENTRE[0], v - CENTRE[1]);
        let wanted = x.hypot(y) / f;
        (wanted <= radius(limit)).then_some(())?;
        let (mut low, mut high) = (0.0, limit);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if radius(middle) < wanted { low = middle } else { high = middle }
        }
        Some(looking_up(0.5 * (low + high), x, y))
    })
}

fn unified_sphere() -> Specimen {
    let (xi, f) = (0.93, 270.0);
    specimen("unified-sphere", "unified-sphere", format!("xi = {xi}\nfocal_length_px = {f:?}\n"), move |u, v| {
        // From ξ below the centre of the unit sphere; where the ray leaves the sphere is where the world is.
        let (from, d) = (V::new(0.0, 0.0, -xi), V::new(u - CENTRE[0], v - CENTRE[1], f).normalize());
        let at = from + d * Quadric::sphere(0.0, 1.0).hits(&from, &d)?[1];
        Some(OutwardRay { origin_mm: V::zeros(), direction: at.normalize() })
    })
}

fn polynomial() -> Specimen {
    let forward = [-190.0, 0.0, 1.1e-3, 6e-7, 2e-9];
    specimen("polynomial", "polynomial", format!("forward = {forward:?}\n"), move |u, v| {
        let (x, y) = (u - CENTRE[0], v - CENTRE[1]);
        let rho = x.hypot(y);
        let depth: f64 = forward.iter().enumerate().map(|(i, c)| c * rho.powi(i as i32)).sum();
        Some(OutwardRay { origin_mm: V::zeros(), direction: V::new(x, y, -depth).normalize() })
    })
}

fn mosaic() -> Specimen {
    let (arm_mm, slit_deg, f, size) = (120.0, 15.0_f64, 180.0, [1080, 300]);
    let horizon = 149.5;
    let trace = move |u: f64, v: f64| {
        // Once round clockwise from behind; the camera stands at the arm's end and looks a little off it.
        let arm = PI - TAU * (u + 0.5) / f64::from(size[0]);
        let (sin, cos) = (arm + slit_deg.to_radians()).sin_cos();
        let origin_mm = V::new(arm.cos(), arm.sin(), 0.0) * arm_mm;
        Some(OutwardRay { origin_mm, direction: V::new(f * cos, f * sin, horizon - v).normalize() })
    };
    let table = format!(
        "radius_mm = {arm_mm:?}\nslit_deg = {slit_deg:?}\nfocal_length_px = {f:?}\nhorizon_px = {horizon}\nturn_s = 30.0\n"
    );
    Specimen { name: "mosaic", model: "mosaic", size_px: size, table, trace: Box::new(trace) }
}

fn pinhole() -> Specimen {
    let f = 700.0;
    specimen("pinhole", "pinhole", format!("focal_length_px = {f:?}\n"), move |u, v| {
        let direction = V::new(f, CENTRE[0] - u, CENTRE[1] - v).normalize();
        Some(OutwardRay { origin_mm: V::zeros(), direction })
    })
}
