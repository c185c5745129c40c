//! People who meet: each goes on as who he was.

use protocol::angle::difference;
use protocol::appearance::{Appearance, BANDS, Band};
use protocol::id::TrackId;

use crate::tracking::Expected;

use super::*;

#[test]
fn each_of_two_is_where_the_marks_look_like_him() {
    let mut room = Room::new([-15.0, 20.0]);
    let clothes = |gray: u8| Appearance([Some(Band::of(f64::from(gray), 5.0)); BANDS]);
    let (dark, bright) = (clothes(40), clothes(170));
    let shape = Shape::default();
    for [left, right] in [[40, 170], [170, 40]] {
        for middle_deg in [0.0, 180.0] {
            let people =
                [(7.0, left), (-7.0, right)].map(|(aside, gray)| Person { gray, ..person(middle_deg + aside, 2.5) });
            room.look(&people);
            // Both are expected in the middle between them.
            let middle = Person { bearing: f64::to_radians(middle_deg), ..people[0] };
            let expected =
                |looks| Sought { looks: Some(looks), column_sigma: 12.0, ..at_truth(&room, &middle, &shape) };
            let found = room.figures.fit(&[expected(&dark), expected(&bright)]);
            for (figure, gray) in found.iter().zip([40, 170]) {
                let truth = people.iter().find(|p| p.gray == gray).unwrap();
                let off = difference(room.geometry.bearing_of_column(figure.column), truth.bearing).to_degrees();
                assert!(off.abs() < 3.0, "{gray} at {middle_deg}°, {left} on the left: {off:.1}° off");
            }
        }
    }
}

/// Two come up to each other, one is behind the other for as long, where they stand or walk on together, and they go: back, or on.
/// The numbers before, 0.6 s after they part and 3 s after, of the one behind and of the one in front.
fn meet(start_deg: f64, behind_s: f64, together_deg_s: f64, back: bool) -> [[Option<TrackId>; 2]; 3] {
    const WALK_S: f64 = 3.0;
    const DEG_S: f64 = 18.0;
    let mut room = Room::new([-15.0, 20.0]);
    let mut tracker = Tracker::new(room.raster, room.view.clone(), TrackerSettings::default());
    let mut ids = [[None; 2]; 3];
    let frames = ((2.0 * WALK_S + behind_s) * 10.0) as i32;
    for frame in 0..=frames {
        let t = f64::from(frame) * 0.1;
        let gone_s = (t - WALK_S - behind_s).max(0.0);
        let middle_deg = start_deg + together_deg_s * (t - WALK_S).clamp(0.0, behind_s);
        let aside = DEG_S * ((WALK_S - t).max(0.0) + if back { gone_s } else { -gone_s });
        let behind = Person { gray: 40, ..person(middle_deg + aside, 2.6) };
        let front = Person { gray: 170, ..person(middle_deg - aside, 1.8) };
        room.look(&[behind, front]);
        let walks = t < WALK_S || gone_s > 0.0 || together_deg_s != 0.0;
        room.track(&mut tracker, &room.objects(|_| walks), t);
        let at = |p: &Person| {
            let near = |v: &&TrackView| difference(v.bearing_rad, p.bearing).abs() < (0.25 / p.range_m).atan();
            let tracks = tracker.tracks();
            let found: Vec<_> = tracks.iter().filter(near).map(|v| v.id).collect();
            (found.len() == 1).then(|| found[0])
        };
        // Some frames before they come together, and some after they have parted.
        let asked = [15, ((WALK_S + behind_s + 0.6) * 10.0).round() as i32, frames];
        if let Some(n) = asked.iter().position(|f| *f == frame) {
            ids[n] = [at(&behind), at(&front)];
        }
    }
    ids
}

/// Both are known before, and have their numbers soon after they part and later.
#[track_caller]
fn keep_their_numbers(start_deg: f64, behind_s: f64, together_deg_s: f64, back: bool) {
    let [before, soon, after] = meet(start_deg, behind_s, together_deg_s, back);
    assert!(before.iter().all(Option::is_some), "from {start_deg}°: {before:?}");
    assert_eq!([before, before], [soon, after], "from {start_deg}°, back {back}");
}

#[test]
fn two_who_pass_keep_their_numbers_and_so_do_two_who_turn_back_on_the_seam() {
    keep_their_numbers(20.0, 0.5, 0.0, false);
    keep_their_numbers(180.0, 0.5, 0.0, true);
}

#[test]
fn who_stood_behind_somebody_for_long_comes_out_under_his_number() {
    keep_their_numbers(-60.0, 4.0, 0.0, true);
    keep_their_numbers(180.0, 4.0, 0.0, false);
}

#[test]
fn who_walked_on_behind_somebody_comes_out_under_his_number() {
    keep_their_numbers(-20.0, 3.0, 18.0, true);
    keep_their_numbers(150.0, 3.0, 18.0, false);
}

#[test]
fn who_is_hidden_makes_nobody_a_part_of_him() {
    let mut room = Room::new([-15.0, 20.0]);
    let front = person(30.0, 2.1);
    room.look(&[front]);
    let shape = Shape::default();
    let sought = |range_m, seniority| Sought { seniority, ..at_truth(&room, &Person { range_m, ..front }, &shape) };
    let found = room.figures.fit(&[sought(3.6, 90), sought(2.1, 80)]);
    assert!(!found[0].shows(), "{found:?}");
    assert!(found[1].shows() && found[1].evidence > 0.5, "{found:?}");
}

#[test]
fn being_told_of_people_doubles_none_and_makes_none_where_the_picture_shows_nobody() {
    let told = [person(20.0, 2.5), person(-175.0, 3.5)];
    for people in [&told[..], &told[..1], &[]] {
        let mut room = Room::new([-15.0, 20.0]);
        let mut tracker = Tracker::new(room.raster, room.view.clone(), TrackerSettings::default());
        room.look(people);
        let objects = room.objects(|_| true);
        for frame in 0..15 {
            let expected = |person: &Person| Expected {
                track: None,
                bearing_rad: person.bearing,
                bearing_sigma_rad: 0.15 / person.range_m,
                range_m: 1.05 * person.range_m,
                log_range_sigma: 0.15 / person.range_m,
            };
            tracker.expect(told.iter().map(expected).collect());
            room.track(&mut tracker, &objects, 0.1 * f64::from(frame));
        }
        let tracks = tracker.tracks();
        assert_eq!(tracks.len(), people.len(), "{tracks:?}");
        for person in people {
            assert!(tracks.iter().any(|t| difference(t.bearing_rad, person.bearing).abs() < 0.03), "{tracks:?}");
        }
    }
}

#[test]
fn who_has_long_walked_alone_is_told_surely_and_who_is_new_or_beside_another_is_not() {
    let mut room = Room::new([-15.0, 20.0]);
    let mut tracker = Tracker::new(room.raster, room.view.clone(), TrackerSettings::default());
    // Of the walker in each frame: time, told sigma and error aside, metres.
    let mut told: Vec<(f64, f64, f64)> = Vec::new();
    for frame in 0..=100 {
        let t = f64::from(frame) * 0.1;
        let walker = Person { gray: 40, ..person(-80.0 + 15.0 * t, 2.6) };
        // Comes towards him and goes on before him.
        let ahead_deg = 5.0 + 25.0 * (8.0 - t).max(0.0);
        let other = Person { gray: 170, ..person(-80.0 + 15.0 * t + ahead_deg, 1.9) };
        let people = [walker, other];
        room.look(if t < 6.0 { &people[..1] } else { &people });
        room.track(&mut tracker, &room.objects(|_| true), t);
        let off = |v: &TrackView| difference(v.bearing_rad, walker.bearing) * walker.range_m;
        if let Some(v) = tracker.tracks().into_iter().min_by_key(|v| v.id) {
            told.push((t, v.bearing_sigma_rad * walker.range_m, off(&v)));
        }
    }
    let mean_m = |from: f64, to: f64| {
        let sigmas: Vec<f64> = told.iter().filter(|x| (from..to).contains(&x.0)).map(|x| x.1).collect();
        sigmas.iter().sum::<f64>() / sigmas.len() as f64
    };
    let (new_m, alone_m, beside_m) = (told[0].1, mean_m(4.0, 5.5), mean_m(8.5, 10.0));
    println!("new {new_m:.3}, alone {alone_m:.3}, beside another {beside_m:.3} m");
    assert!(new_m > 1.5 * alone_m && beside_m > 1.5 * alone_m, "{new_m}, {alone_m}, {beside_m}");
    for (t, sigma_m, off_m) in told {
        assert!(off_m.abs() < 4.0 * sigma_m, "at {t:.1} s: {off_m:.3} m off, {sigma_m:.3} told");
    }
}

#[test]
fn who_stops_as_soon_as_he_is_seen_is_followed_where_he_stands_out_of_the_background_and_goes_where_he_may_be_a_trace()
{
    let frames_followed = |outline: Outline| {
        let mut room = Room::new([-15.0, 20.0]);
        let mut tracker = Tracker::new(room.raster, room.view.clone(), TrackerSettings::default());
        let mut followed = 0;
        for frame in 0..100 {
            // Two steps aside from behind something, then he stands.
            let walks = frame < 5;
            let person = person(20.0 + 0.5 * f64::from(frame.min(5)), 2.5);
            room.look(&[person]);
            let objects: Vec<_> = room.objects(|_| walks).into_iter().map(|o| Object { outline, ..o }).collect();
            room.track(&mut tracker, &objects, 0.1 * f64::from(frame));
            followed += usize::from(tracker.tracks().len() == 1);
        }
        followed
    };
    let (solid, unclear, trace) = [Outline::Picture, Outline::Unclear, Outline::Background].map(frames_followed).into();
    assert!(solid > 95 && unclear < 30 && trace < 30, "{solid} {unclear} {trace}");
}

/// In how many of 60 frames somebody is followed who stands where the robot saw nobody walk to, if the team says that he is at
/// a distance known to `sigma_m`.
fn frames_followed(sigma_m: Option<f64>) -> usize {
    let mut room = Room::new([-15.0, 20.0]);
    let mut tracker = Tracker::new(room.raster, room.view.clone(), TrackerSettings::default());
    let stands = person(20.0, 2.5);
    room.look(&[stands]);
    let objects = room.objects(|_| false);
    let mut followed = 0;
    for frame in 0..60 {
        let expected = |sigma_m: f64| Expected {
            track: tracker.tracks().first().map(|t| t.id),
            bearing_rad: stands.bearing,
            bearing_sigma_rad: 0.1 / stands.range_m,
            range_m: stands.range_m,
            log_range_sigma: sigma_m / stands.range_m,
        };
        tracker.expect(sigma_m.map(expected).into_iter().collect());
        room.track(&mut tracker, &objects, 0.1 * f64::from(frame));
        followed += usize::from(tracker.tracks().len() == 1);
    }
    followed
}

#[test]
fn who_stands_is_followed_where_the_others_surely_see_him_and_not_for_a_guess() {
    let (sure, guessed, alone) = (frames_followed(Some(0.15)), frames_followed(Some(0.6)), frames_followed(None));
    assert!(sure > 50 && guessed == 0 && alone == 0, "{sure} {guessed} {alone}");
}

#[test]
fn who_stands_while_others_pass_behind_him_is_kept_out_of_the_background() {
    let mut room = Room::new([-15.0, 20.0]);
    let mut tracker = Tracker::new(room.raster, room.view.clone(), TrackerSettings::default());
    for frame in 0..90 {
        let t = 0.1 * f64::from(frame);
        let stands = person(20.0 - 10.0 * t.min(2.0), 2.0);
        // To and fro, and never apart from him: what the two are in moves.
        let passes = Person { gray: 170, ..person(6.0 * (2.0 * t).sin(), 3.0) };
        room.look(&[stands, passes]);
        room.track(&mut tracker, &room.objects(|_| true), t);
        let column = room.geometry.column_of_bearing(stands.bearing);
        let kept = tracker.holds().keep.iter().any(|p| {
            let middle = p.arc.start as f64 + 0.5 * p.arc.width as f64;
            room.raster.column_difference(middle, column).abs() < 0.2 * p.arc.width as f64
        });
        assert!(t < 6.0 || kept, "after {t:.1} s: {:?}", tracker.holds().keep);
    }
}
