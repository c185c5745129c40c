//! Figures on masks of people drawn as boxes and discs, in metres, through the panorama's angles.

use protocol::message::TrackState;
use protocol::time::Timestamp;

use super::*;
use crate::motion::{Object, Outline};
use crate::optics::{MountedCamera, Mounting, Pal};
use crate::panorama::{PanoramaGeometry, Projection};
use crate::tracking::{TrackView, Tracker, TrackerSettings};

mod meeting;

const CAMERA_M: f64 = 0.6;

/// Somebody at a bearing (radians) and a distance (m): height, distance of the feet from the axis (m), rows that cannot be
/// told from what is behind (from, to: heights in metres).
#[derive(Debug, Clone, Copy)]
struct Person {
    bearing: f64,
    range_m: f64,
    height_m: f64,
    stride_m: f64,
    camouflaged_m: [f64; 2],
    /// Of the clothes.
    gray: u8,
    /// How far one arm reaches out from the axis, m; not at all below the shoulders' breadth.
    arm_m: f64,
}

fn person(bearing_deg: f64, range_m: f64) -> Person {
    let bearing = bearing_deg.to_radians();
    Person { bearing, range_m, height_m: 1.75, stride_m: 0.12, camouflaged_m: [0.0, 0.0], gray: 60, arm_m: 0.0 }
}

impl Person {
    /// Whether a place (m aside of the axis, m above the floor) is of the body: head, neck, trunk with arms, two legs.
    fn covers(&self, x: f64, z: f64) -> bool {
        let h = self.height_m;
        if (self.camouflaged_m[0]..self.camouflaged_m[1]).contains(&z) || !(0.0..h).contains(&z) {
            return false;
        }
        if z > 0.87 * h {
            return x.abs() < 0.085;
        }
        if z > 0.83 * h {
            return x.abs() < 0.06;
        }
        if z > 0.5 * h {
            let arm = (0.74 * h..0.8 * h).contains(&z) && (0.0..self.arm_m).contains(&x);
            return arm || x.abs() < 0.22;
        }
        // Legs from the hips to the feet.
        let spread = self.stride_m * (1.0 - z / (0.5 * h));
        (x - spread).abs() < 0.08 || (x + spread).abs() < 0.08
    }
}

struct Room {
    raster: Raster,
    view: View,
    geometry: PanoramaGeometry,
    figures: Figures,
    mask: Vec<u8>,
    picture: Vec<u8>,
    valid: Vec<u8>,
}

impl Room {
    fn new(elevation_deg: [f64; 2]) -> Self {
        let camera = MountedCamera::new(Pal::reference(), Mounting::at_height(CAMERA_M));
        let height = ((elevation_deg[1].to_radians().tan() - elevation_deg[0].to_radians().tan()) / 0.00582) as u32;
        let range = elevation_deg.map(f64::to_radians);
        let geometry = PanoramaGeometry::new(1080, height, Projection::Cylinder, range).unwrap();
        let view = View::panorama(geometry, &camera);
        let raster = Raster { width: 1080, height: height as usize, wraps: true };
        let figures = Figures::new(&view, &raster).unwrap();
        Self {
            raster,
            view,
            geometry,
            figures,
            mask: vec![0; raster.len()],
            picture: vec![100; raster.len()],
            valid: vec![1; raster.len()],
        }
    }

    fn look(&mut self, people: &[Person]) {
        self.mask.fill(0);
        for y in 0..self.raster.height {
            for x in 0..self.raster.width {
                let (bearing, elevation) = self.view.angles_rad(x as f64, y as f64).unwrap();
                let there = people.iter().filter(|p| {
                    let aside = protocol::angle::difference(bearing, p.bearing);
                    let z = CAMERA_M + p.range_m * elevation.tan();
                    aside.abs() < 1.2 && p.covers(p.range_m * aside.tan(), z)
                });
                let nearest = there.min_by(|a, b| a.range_m.total_cmp(&b.range_m));
                let i = y * self.raster.width + x;
                self.mask[i] = u8::from(nearest.is_some());
                self.picture[i] = nearest.map_or(100, |p| p.gray);
            }
        }
        self.look_at_the_mask();
    }

    fn look_at_the_mask(&mut self) {
        let (raster, mask, valid, picture) = (&self.raster, &self.mask, &self.valid, &self.picture);
        let scene = Scene { picture, ..Scene::of_marks(raster, mask, valid) };
        self.figures.look(&scene, &[], &Doubts::default());
    }

    fn scene(&self) -> Scene<'_> {
        Scene::of_marks(&self.raster, &self.mask, &self.valid)
    }

    /// The regions of what was looked at, of which those move that `moves` says do.
    fn objects(&self, moves: impl Fn(&Region) -> bool) -> Vec<Object> {
        let regions = crate::motion::group(&self.mask, &self.raster, [1, 1], 1);
        regions.into_iter().map(|region| Object { moves: moves(&region), region, outline: Outline::Unclear }).collect()
    }

    /// A frame for a tracker, `t` seconds after the first.
    fn track(&self, tracker: &mut Tracker, objects: &[Object], t: f64) {
        let scene = Scene { picture: &self.picture, objects, ..self.scene() };
        tracker.step(&scene, Timestamp::from_secs_f64(100.0 + t), &[]);
    }

    /// Lateral error of the axis, metres, and the ratio of the distances.
    #[track_caller]
    fn check(&self, figure: &Figure, person: &Person, lateral_m: f64, ratio: f64) {
        self.check_among(std::slice::from_ref(figure), figure, person, lateral_m, ratio);
    }

    #[track_caller]
    fn check_among(&self, all: &[Figure], figure: &Figure, person: &Person, lateral_m: f64, ratio: f64) {
        let index = all.iter().position(|f| f == figure).unwrap();
        let region = self.figures.own(all, &self.scene()).remove(index).unwrap();
        let axis = self.figures.axis(figure, &region, &self.view);
        let error = protocol::angle::difference(self.geometry.bearing_of_column(axis), person.bearing) * person.range_m;
        assert!(error.abs() < lateral_m, "{error:.3} m beside {person:?}: {figure:?}");
        let found = figure.range_m / person.range_m;
        assert!((1.0 / ratio..ratio).contains(&found), "{:.2} m for {person:?}", figure.range_m);
    }
}

#[test]
fn somebody_is_found_once_at_every_distance_and_over_the_seam() {
    let mut room = Room::new([-15.0, 20.0]);
    for (range_m, stride_m) in [(0.9, 0.2), (1.4, 0.25), (2.0, 0.1), (3.0, 0.25), (4.5, 0.1), (7.0, 0.2)] {
        for bearing_deg in [10.0, 179.5] {
            let p = Person { stride_m, ..person(bearing_deg, range_m) };
            room.look(&[p]);
            let found = room.figures.find(&[]);
            assert_eq!(found.len(), 1, "{p:?}: {:?}", found.iter().map(|f| (f.column, f.range_m)).collect::<Vec<_>>());
            room.check(&found[0], &p, 0.04, 1.45);
        }
    }
}

/// What is found after the frames in which one figure may still stand for two, left to right.
fn found_in_the_end(room: &Room) -> Vec<Figure> {
    let mut found = room.figures.find(&[]);
    for _ in 0..3 {
        let shape = Shape::default();
        let sought: Vec<Sought<'_>> = found.iter().map(|f| sought(f, &shape)).collect();
        let mut next = room.figures.fit(&sought);
        next.extend(room.figures.find(&next));
        found = next;
    }
    found
}

#[test]
fn two_people_beside_each_other_are_two_also_shoulder_to_shoulder_over_the_seam() {
    let mut room = Room::new([-15.0, 20.0]);
    let apart = (person(40.0, 3.5), Person { height_m: 1.6, ..person(31.0, 3.7) });
    let touching = (person(-176.3, 3.5), Person { height_m: 1.6, ..person(176.3, 3.5) });
    for (a, b) in [apart, touching] {
        room.look(&[a, b]);
        let found = found_in_the_end(&room);
        assert_eq!(found.len(), 2, "{:?}", found.iter().map(|f| (f.column, f.range_m)).collect::<Vec<_>>());
        for p in [a, b] {
            let away =
                |f: &Figure| room.raster.column_difference(f.column, room.geometry.column_of_bearing(p.bearing)).abs();
            let nearest = found.iter().min_by(|f, g| away(f).total_cmp(&away(g))).unwrap();
            room.check_among(&found, nearest, &p, 0.08, 1.3);
        }
    }
}

#[test]
fn one_person_with_an_arm_out_is_one() {
    let mut room = Room::new([-15.0, 20.0]);
    for range_m in [1.5, 3.0] {
        let p = Person { arm_m: 0.6, ..person(70.0, range_m) };
        room.look(&[p]);
        let found = found_in_the_end(&room);
        assert_eq!(
            found.len(),
            1,
            "{range_m} m: {:?}",
            found.iter().map(|f| (f.column, f.range_m)).collect::<Vec<_>>()
        );
    }
}

fn sought<'a>(figure: &Figure, shape: &'a Shape) -> Sought<'a> {
    Sought {
        column: figure.column,
        column_sigma: 3.0,
        range_m: figure.range_m,
        log_range_sigma: 0.2,
        known_range: false,
        shape,
        seniority: 5,
        looks: None,
    }
}

#[test]
fn what_lies_below_the_horizon_is_nobody() {
    let mut room = Room::new([-15.0, 20.0]);
    // A robot half a metre high, and a long shadow.
    let robot = Person { height_m: 0.5, ..person(-60.0, 1.5) };
    room.look(&[robot]);
    for y in 80..105 {
        room.mask[y * 1080 + 300..y * 1080 + 420].fill(1);
    }
    room.look_at_the_mask();
    assert_eq!(room.figures.find(&[]).len(), 0);
}

#[test]
fn somebody_behind_another_keeps_a_place_and_says_how_much_is_seen() {
    let mut room = Room::new([-15.0, 20.0]);
    let (front, behind) = (person(0.0, 1.8), person(6.0, 4.0));
    room.look(&[front, behind]);
    let shape = Shape::default();
    let at = |p: &Person| at_truth(&room, p, &shape);
    let found = room.figures.fit(&[at(&front), at(&behind)]);
    assert!(found[0].own > 0.95 && found[1].own < 0.8, "{:.2} {:.2}", found[0].own, found[1].own);
    // A third in the same place as the first has no evidence of its own.
    let third = Sought { seniority: 1, ..at(&front) };
    let found = room.figures.fit(&[at(&front), at(&behind), third]);
    assert!(found[0].evidence > 0.5 && found[2].evidence < 0.1, "{:.2} {:.2}", found[0].evidence, found[2].evidence);
}

#[test]
fn clothes_like_the_wall_are_learnt() {
    let mut room = Room::new([-15.0, 20.0]);
    let p = Person { camouflaged_m: [0.8, 1.3], ..person(-20.0, 3.0) };
    room.look(&[p]);
    let mut shape = Shape::default();
    let mut figure = room.figures.fit(&[at_truth(&room, &p, &shape)]).remove(0);
    let before = figure.support;
    for _ in 0..15 {
        room.figures.learn(&figure, &mut shape);
        figure = room.figures.fit(&[at_truth(&room, &p, &shape)]).remove(0);
    }
    assert!(before < 0.75 && figure.support > before + 0.15, "{before:.2} {:.2}", figure.support);
    room.check(&figure, &p, 0.04, 1.2);
}

fn at_truth<'a>(room: &Room, p: &Person, shape: &'a Shape) -> Sought<'a> {
    Sought {
        column: room.geometry.column_of_bearing(p.bearing),
        column_sigma: 3.0,
        range_m: p.range_m,
        log_range_sigma: 0.1,
        known_range: false,
        shape,
        seniority: 5,
        looks: None,
    }
}

/// Below about 3 m head and feet leave the picture, and the figure is taken for a nearer one for a while after they are back.
#[test]
fn the_feet_of_who_goes_away_and_comes_back_give_his_distance() {
    let mut room = Room::new([-15.0, 20.0]);
    let mut tracker = Tracker::new(room.raster, room.view.clone(), TrackerSettings::default());
    let (mut in_view, mut given) = (0, 0);
    for frame in 0..110 {
        let t = f64::from(frame) * 0.1;
        // From the left to 0° in 2 s, away at 1 m/s, back from 6.5 s on.
        let gone_m = (t - 2.0).clamp(0.0, 4.5) - (t - 6.5).max(0.0);
        let stride_m = 0.12 + 0.1 * (t * 5.0).sin();
        let p = Person { stride_m, ..person((20.0 - 10.0 * t).max(0.0), 1.1 + gone_m) };
        room.look(&[p]);
        room.track(&mut tracker, &room.objects(|_| true), t);
        if t > 2.0 && p.range_m > 2.5 {
            in_view += 1;
            for range in tracker.tracks().iter().filter_map(|track| track.extent.range) {
                given += 1;
                let off = range.range_m - p.range_m;
                assert!(off.abs() < 2.5 * range.sigma_m, "{t:.1} s, {:.2} m: {range:?}", p.range_m);
            }
        }
    }
    assert!(4 * given >= 3 * in_view, "{given} of {in_view}");
}

#[test]
fn who_stands_and_is_covered_for_a_while_is_the_same_afterwards() {
    let mut room = Room::new([-15.0, 20.0]);
    let mut tracker = Tracker::new(room.raster, room.view.clone(), TrackerSettings::default());
    let (mut stands, mut passes) = (None, None);
    for frame in 0..120 {
        let t = f64::from(frame) * 0.1;
        // One comes from the left and stands at 0° from 2.5 s on; another comes before him at
        // 5 s, stays for 3.5 s and goes on.
        let first = Person { gray: 40, ..person((25.0 - 10.0 * t).max(0.0), 4.0) };
        let second = Person { gray: 170, ..person(8.0 * (t.min(5.0) + (t - 8.5).max(0.0)) - 40.0, 2.5) };
        room.look(&[first, second]);
        let width = |p: &Person| (0.25 / p.range_m).atan();
        let moving = |region: &Region| {
            let bearing = room.geometry.bearing_of_column(region.arc.centre());
            let walks = !(5.0..8.5).contains(&t);
            t < 2.5 || walks && protocol::angle::difference(bearing, second.bearing).abs() < width(&second)
        };
        room.track(&mut tracker, &room.objects(moving), t);
        let at = |p: &Person| {
            let near = |v: &&TrackView| protocol::angle::difference(v.bearing_rad, p.bearing).abs() < width(p);
            let tracks = tracker.tracks();
            let found: Vec<_> = tracks.iter().filter(near).map(|v| v.id).collect();
            (found.len() == 1).then(|| found[0])
        };
        if frame == 38 {
            (stands, passes) = (at(&first), at(&second));
        }
        if frame == 119 {
            assert!(stands.is_some() && stands == at(&first), "{stands:?} {:?}", at(&first));
            assert!(passes.is_some() && passes == at(&second), "{passes:?} {:?}", at(&second));
        }
    }
}

/// His shadow falls on what is behind him and goes with him: where that has a pattern it is seen through the shadow, and a bare wall is a
/// little darker all over. Somebody may look so too: where nobody casts a shadow he is one.
/// Level of what is a shadow, or looks like one all over.
const SHADE: u8 = 1;

/// A frame before a wall of some pattern, in which clothes are darker than it, `t` seconds after the first.
fn track_before_a_wall(tracker: &mut Tracker, room: &mut Room, pattern: f64, people: &[Person], t: f64) {
    let width = room.raster.width;
    let behind = |x: usize, y: usize| 120.0 + pattern * (x as f64 / 3.0).sin() * (y as f64 / 4.0).cos();
    let background: Vec<u16> = (0..room.raster.len()).map(|i| (256.0 * behind(i % width, i / width)) as u16).collect();
    room.look(people);
    for (i, pixel) in room.picture.iter_mut().enumerate() {
        let (x, y) = (i % width, i / width);
        match (room.mask[i], *pixel) {
            (0, _) => *pixel = behind(x, y) as u8,
            // Its edge runs over many columns, so that its darkness is nowhere the same.
            (_, SHADE) => *pixel = (behind(x, y) * (0.75 + 0.15 * (x as f64 / 20.0).sin())) as u8,
            _ => *pixel = (60.0 + 25.0 * (x as f64 / 2.0).cos()) as u8,
        }
    }
    let objects = room.objects(|_| true);
    let scene = Scene { picture: &room.picture, background: &background, objects: &objects, ..room.scene() };
    tracker.step(&scene, Timestamp::from_secs_f64(100.0 + t), &[]);
}

#[test]
fn a_shadow_is_nobody_on_shelves_and_on_a_bare_wall_and_who_looks_like_one_is_somebody_where_nobody_casts_it() {
    for (pattern, with_walker) in [(40.0, true), (0.0, true), (0.0, false)] {
        let mut room = Room::new([-15.0, 20.0]);
        let mut tracker = Tracker::new(room.raster, room.view.clone(), TrackerSettings::default());
        for frame in 0..60 {
            let t = f64::from(frame) * 0.1;
            let walker = Person { gray: 60, ..person(30.0 - 10.0 * t, 3.0) };
            let shadow = Person { gray: SHADE, ..person(44.0 - 10.0 * t, 4.5) };
            let dull = Person { gray: SHADE, ..walker };
            let cast = [walker, shadow];
            let people = if with_walker { &cast[..] } else { std::slice::from_ref(&dull) };
            track_before_a_wall(&mut tracker, &mut room, pattern, people, t);
        }
        let tracks = tracker.tracks();
        assert_eq!(
            tracks.len(),
            1,
            "{pattern} {with_walker}: {:?}",
            tracks.iter().map(|t| t.bearing_rad).collect::<Vec<_>>()
        );
    }
}

#[test]
fn who_looks_like_a_shadow_and_came_alone_is_followed_on_when_others_come_near() {
    let mut room = Room::new([-15.0, 20.0]);
    let mut tracker = Tracker::new(room.raster, room.view.clone(), TrackerSettings::default());
    let mut dull_id = None;
    for frame in 0..70 {
        let t = f64::from(frame) * 0.1;
        let dull = Person { gray: SHADE, ..person(30.0 - 6.0 * t, 3.0) };
        // Beside him after four seconds.
        let other = Person { gray: 60, ..person(dull.bearing.to_degrees() - 14.0 - 20.0 * (4.0 - t).max(0.0), 3.0) };
        track_before_a_wall(&mut tracker, &mut room, 0.0, &[dull, other], t);
        let tracks = tracker.tracks();
        let near = |t: &&TrackView| {
            protocol::angle::difference(t.bearing_rad, dull.bearing).abs() < 0.06 && t.state == TrackState::Visible
        };
        let found = tracks.iter().find(near).map(|t| t.id);
        dull_id = dull_id.or(found);
        assert!(frame < 15 || found.is_some() && found == dull_id, "{t:.1} s: {found:?}, {dull_id:?} at first");
    }
}
