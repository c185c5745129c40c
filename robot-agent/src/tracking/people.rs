//! Following people by the figures they make (see [`super::figures`]): tracks predict them, the frame places them.

use protocol::appearance::Appearance;
use protocol::id::TrackId;
use protocol::message::TrackState;
use protocol::time::Timestamp;

use super::body::solid_rows;
use super::figures::{Figure, Figures, Shape, Sought, Span};
use super::proof::Doubts;
use super::shade::{Shaded, shaded};
use super::told::Manner;
use super::track::{Sighting, Track};
use super::{PeerBearing, Tracker, association, looks};
use crate::motion::{Object, Outline, Region, Scene};

/// What a figure must explain in a frame to be seen, and of late to exist, beyond what seniors explain.
const LEAST_EVIDENCE: f32 = 0.12;
const LEAST_MEAN_EVIDENCE: f64 = 0.1;
/// Own share below which somebody is not seen alone.
const ALONE: f32 = 0.85;
/// The same for somebody new.
const NEW_SUPPORT: f32 = 0.4;
const NEW_OWN: f32 = 0.5;
/// What somebody whom only others saw until now must explain that no known figure does.
const TOLD_EVIDENCE: f32 = 0.4;
/// Own share up to which somebody who is not seen is behind others, and within how far he is where he would be hidden best, metres.
const COVERED: f32 = 0.5;
const BEHIND_M: f64 = 0.25;
/// How much he must look like himself when he comes out, nats, and what is taken to speak for him until then.
const BEHIND_ALIKE: f64 = -2.0;
const COVERED_EVIDENCE: f32 = 0.3;
/// Own share from which on somebody in doubt is compared with those who were beside him.
const COMPARED_OWN: f32 = 0.6;
/// Share of the pixels that must be in moving objects for the person to move.
const MOVING: f64 = 0.4;
/// Fellow robots reach this far above the horizon (their masts are too thin to matter), and their outlines this far beyond
/// their sides while they drive, radians.
const ROBOT_TOP_RAD: f64 = 0.04;
const ROBOT_SIDE_RAD: f64 = 0.02;

/// Somebody who was with others comes out no further from where he was placed than this, metres, nor at a distance that
/// differs more (a logarithm); and so alike he is. Without him where he was placed so much may be missing, as a part of what speaks for
/// him there: in a crowd he is sooner badly placed than somebody new.
const OUT_M: f64 = 0.7;
const OUT_LOG_RANGE: f64 = 0.7;
const MOST_ELSEWHERE: f32 = 1.3;
const LEAST_ALIKE: f64 = -3.0;
/// From where he was last seen apart he has not come further than this, metres, and metres a second since.
const COME_M: [f64; 2] = [0.4, 1.6];

/// Whoever was hidden by others for long comes out no further from where he was last thought to be, metres.
const WANDERED_M: f64 = 1.2;

/// Breadth of the trunk.
pub(super) const SHOULDERS_M: f64 = 0.42;

/// Middle column, half width in columns and first row of a fellow robot.
pub(super) type Robot = (f64, f64, usize);

/// Hair and faces differ less from a wall than clothes: share of the typical row's change that the top row must have.
const SOLID_HEAD: f64 = 0.25;

/// Shadows fall no further from somebody than this, metres across the line of sight.
const SHADOW_M: f64 = 2.0;

/// Marks are doubted no further from who may cast shadows than this, metres across the line of sight: lamps that stand low cast them far.
const CAST_M: f64 = 4.0;
/// Half of the breadth in which marks are left to who only looks like a shadow, metres.
const SMOOTH_M: f64 = 0.4;

/// The columns within some distance of a track, metres.
fn span_of(track: &Track, within_m: f64, figures: &Figures) -> Span {
    Span { middle: track.filter.column, half: figures.columns_of(within_m, track.log_range.exp()) }
}

/// Where the shadows fall of who is known to have a body.
fn shadows_of(track: &Track, figures: &Figures) -> Option<Span> {
    (track.confirmed && track.proof.has_body()).then(|| span_of(track, CAST_M, figures))
}

/// How somebody appears in a frame.
struct Look {
    sighting: Sighting,
    area: usize,
    outline: Outline,
    /// Whether it is what is behind, in the shade.
    shaded: Shaded,
}

impl Tracker {
    /// A frame of a panorama from a known height.
    pub(super) fn step_people(&mut self, scene: &Scene<'_>, capture: Timestamp, dt_s: f64, peers: &[PeerBearing]) {
        let Some(mut figures) = self.figures.take() else { return };
        let robots = self.robots(peers);
        let shadows: Vec<Option<Span>> = self.tracks.iter().map(|t| shadows_of(t, &figures)).collect();
        figures.look(scene, &robots, &self.doubts(&shadows, &figures));
        let mut sought: Vec<Sought<'_>> = self.tracks.iter().map(|t| self.sought(t)).collect();
        let known = sought.len();
        let anybody = Shape::default();
        sought.extend(self.missed(&sought, &anybody));
        let told = sought.len();
        let mut all = figures.fit(&sought);
        all.extend(figures.find(&all));
        let moving = mark_moving(scene);
        let looks: Vec<Option<Look>> = figures
            .own(&all, scene)
            .into_iter()
            .zip(&all)
            .map(|(region, figure)| {
                let region = region?;
                let axis = figures.axis(figure, &region, &self.view);
                Some(self.look(figure, &region, axis, scene, &moving, &robots))
            })
            .collect();
        self.areas.clear();
        let mut looks = looks.into_iter();
        let mut now: Vec<Option<Appearance>> = vec![None; known];
        for (t, figure) in all[..known].iter().enumerate() {
            let look = looks.next().flatten();
            let shaded = look.as_ref().map(|look| self.cast_by_another(look.shaded, figure.column, Some(t), &figures));
            let track = &mut self.tracks[t];
            let covered = track.behind && track.has_come();
            let shadow = shaded.is_some_and(|shaded| track.is_shadow(shaded));
            let seen = figure.shows() && figure.evidence >= LEAST_EVIDENCE && !shadow;
            // Nothing is said against whom others cover; whoever comes out must look like himself.
            let evidence = if shadow { 0.0 } else { figure.evidence };
            track.weigh(f64::from(if covered { evidence.max(COVERED_EVIDENCE) } else { evidence }), dt_s);
            let is_he = |look: &Look| {
                let known = track.looks.firm().filter(|_| track.behind);
                known.is_none_or(|known| known.log_ratio(&look.sighting.appearance) > BEHIND_ALIKE)
            };
            match look.filter(|look| seen && is_he(look)) {
                Some(look) => {
                    self.areas.push((track.id, look.area));
                    let is_apart = figure.apart >= ALONE;
                    if is_apart {
                        figures.learn(figure, &mut track.figure_shape);
                        let others = shadows.iter().enumerate().filter(|(k, _)| *k != t).filter_map(|(_, span)| *span);
                        let alone = !others.into_iter().any(|span| span.contains(figure.column, &self.raster));
                        if let Some(share) = figures.bodily_share(figure) {
                            track.proof.see(share, alone);
                        }
                    }
                    track.average_m = is_apart.then(|| figures.average_range_m(figure));
                    track.see_figure(&look.sighting, capture, &self.raster);
                    now[t] = Some(look.sighting.appearance);
                    let shows = figure.own >= COMPARED_OWN;
                    if track.looks.see_out(now[t].as_ref().filter(|_| shows)) {
                        track.turning_point = Some(capture);
                    }
                }
                None if figure.own < COVERED && track.looks.firm().is_some() => {
                    let within = figures.columns_of(BEHIND_M, figure.range_m);
                    track.stays_behind(figure.column, within, &self.raster);
                }
                None => track.miss(),
            }
        }
        self.suspect(&figures, &all, &now, capture);
        for ((k, figure), look) in all.iter().enumerate().skip(known).zip(looks) {
            let Some(look) = look.filter(|l| l.outline != Outline::Background) else { continue };
            let others_see = k < told;
            match self.cast_by_another(look.shaded, figure.column, None, &figures) {
                Shaded::Surely => continue,
                Shaded::Perhaps if !others_see => continue,
                Shaded::Perhaps | Shaded::No => {}
            }
            let enough = figure.own >= NEW_OWN
                && figure.support >= NEW_SUPPORT
                && (!others_see || figure.evidence >= TOLD_EVIDENCE);
            let reach = figures.columns_of(WANDERED_M, figure.range_m);
            let member =
                enough.then(|| self.member_at(figure, &look.sighting, &all[..told], &figures, capture)).flatten();
            // Unless somebody who was lost there looks more like it.
            let lost = || self.lost.alike(&look.sighting, reach, capture, &self.raster);
            if let Some((t, _)) = member.filter(|(_, alike)| lost().is_none_or(|lost| lost < *alike)) {
                // One of those who were together has come out elsewhere than where he was placed.
                let track = &mut self.tracks[t];
                self.areas.retain(|(id, _)| *id != track.id);
                self.areas.push((track.id, look.area));
                track.comes_out(&look.sighting, capture, &self.raster);
                continue;
            }
            if enough && self.tracks.len() < association::MAX_SIDE {
                let returned = self.lost.take(&look.sighting, reach, capture, &self.raster);
                // What stands may be the trace of somebody who has left, or a chair; or it is who was lost from sight there.
                let may_be_lost =
                    look.outline == Outline::Picture && self.misses_somebody_at(look.sighting.axis, reach);
                if !look.sighting.moves && returned.is_none() && !others_see && !may_be_lost {
                    continue;
                }
                let id = returned.as_ref().map_or_else(|| self.next_track_id(), |lost| lost.id);
                let mut track = Track::of_figure(id, &look.sighting, capture);
                if let Some(lost) = returned {
                    track.returns(lost.looks);
                }
                self.areas.push((track.id, look.area));
                self.tracks.push(track);
            }
        }
        let next_id = &mut self.next_id;
        let new_id = || {
            *next_id = next_id.wrapping_add(1);
            TrackId(next_id.wrapping_sub(1))
        };
        for t in looks::settle(&mut self.tracks, new_id) {
            self.tracks[t].turning_point = Some(capture);
        }
        // Whom nothing speaks for that seniors do not explain is a part of them.
        self.keep_tracks(|t| t.evidence > LEAST_MEAN_EVIDENCE);
        self.figures = Some(figures);
    }

    /// Where marks are doubted, by where shadows of the tracks fall.
    fn doubts(&self, shadows: &[Option<Span>], figures: &Figures) -> Doubts {
        if !self.settings.doubts_shadows {
            return Doubts::default();
        }
        let but = self.tracks.iter().filter(|t| t.confirmed && t.proof.only_looks_like_a_shadow());
        let span = |t: &Track| span_of(t, SMOOTH_M, figures);
        Doubts { shadows: shadows.iter().copied().flatten().collect(), but: but.map(span).collect() }
    }

    /// What looks like a shadow at a column is perhaps one only where the shadow of somebody else than track `but` may fall.
    fn cast_by_another(&self, shaded: Shaded, column: f64, but: Option<usize>, figures: &Figures) -> Shaded {
        let casts = |track: &Track| {
            let reach = figures.columns_of(SHADOW_M, track.log_range.exp());
            track.confirmed && self.raster.column_difference(track.filter.column, column).abs() < reach
        };
        let mut others = self.tracks.iter().enumerate().filter(|(t, _)| Some(*t) != but);
        if shaded == Shaded::Perhaps && !others.any(|(_, track)| casts(track)) { Shaded::No } else { shaded }
    }

    /// Whether somebody is hidden, or was lost behind others, within `reach` columns of a place.
    fn misses_somebody_at(&self, column: f64, reach: f64) -> bool {
        let near = |other: f64| self.raster.column_difference(column, other).abs() < reach;
        let hidden = |t: &Track| t.confirmed && t.state == TrackState::Hidden && near(t.filter.column);
        self.tracks.iter().any(hidden) || self.lost.columns().any(near)
    }

    /// Whether people who are in doubt go on under each other's numbers. `now`: what the tracks look like in this frame.
    fn suspect(&mut self, figures: &Figures, all: &[Figure], now: &[Option<Appearance>], capture: Timestamp) {
        let tracks = &self.tracks;
        self.suspicions.keep(|id| tracks.iter().any(|t| t.id == id && t.looks.in_doubt()));
        let shows = |t: usize| {
            let track = &self.tracks[t];
            let compared = track.confirmed && track.looks.in_doubt() && all[t].own >= COMPARED_OWN;
            Some((t, now[t].filter(|_| compared)?))
        };
        let shown: Vec<(usize, Appearance)> = (0..now.len()).filter_map(shows).collect();
        for (n, (a, now_a)) in shown.iter().enumerate() {
            for (b, now_b) in &shown[..n] {
                let [one, other] = [a, b].map(|t| &self.tracks[*t]);
                let (Some(known_a), Some(known_b)) = (one.looks.firm(), other.looks.firm()) else { continue };
                let nats = looks::exchange_gain([now_a, now_b], [known_a, known_b]);
                let beside = figures.are_beside(&all[*a], &all[*b]);
                let least = f64::from(all[*a].own.min(all[*b].own).min(1.0));
                let clearly = (least - f64::from(COMPARED_OWN)) / (1.0 - f64::from(COMPARED_OWN));
                if self.suspicions.weigh(one.id, other.id, beside, nats, clearly) {
                    looks::exchange(&mut self.tracks, *a, *b);
                    for t in [*a, *b] {
                        self.tracks[t].turning_point = Some(capture);
                    }
                }
            }
        }
    }

    /// Of those who were with others and for whom little speaks where they are, the one who may be seen here, and how alike he is, nats.
    /// `sought`: the figures of the tracks, and of others who were looked for.
    fn member_at(
        &self,
        found: &Figure,
        sighting: &Sighting,
        sought: &[Figure],
        figures: &Figures,
        now: Timestamp,
    ) -> Option<(usize, f64)> {
        let reach = figures.columns_of(OUT_M, found.range_m);
        let may_be = |t: &usize| {
            let track = &self.tracks[*t];
            let away = |from: f64| self.raster.column_difference(from, sighting.axis).abs();
            let (at, from) = track.last_apart;
            let come_m = COME_M[0] + COME_M[1] * now.seconds_since(at);
            track.confirmed
                && track.looks.in_doubt()
                && away(track.filter.column) < reach
                && away(from) < figures.columns_of(come_m, found.range_m)
                && (found.range_m.ln() - track.log_range).abs() < OUT_LOG_RANGE
                && figures.needed(sought, *t) < MOST_ELSEWHERE * found.evidence
        };
        let alike = |t: usize| Some((t, self.tracks[t].looks.firm()?.log_ratio(&sighting.appearance)));
        // Those who are born in this frame are not confirmed.
        let members = (0..self.tracks.len().min(sought.len())).filter(may_be).filter_map(alike);
        let least = |t: usize| if self.tracks[t].behind { BEHIND_ALIKE } else { LEAST_ALIKE };
        members.filter(|(t, nats)| *nats > least(*t)).max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Where fellow robots are.
    fn robots(&self, peers: &[PeerBearing]) -> Vec<Robot> {
        let Some(first_row) = self.view.row_of_elevation(ROBOT_TOP_RAD) else { return Vec::new() };
        peers
            .iter()
            .filter_map(|p| {
                let column = self.view.column_of_bearing(p.bearing_rad)?;
                let step = self.view.steps_rad(column, first_row)[0];
                Some((column, (p.half_width_rad + ROBOT_SIDE_RAD) / step, first_row.max(0.0) as usize))
            })
            .collect()
    }

    fn look(
        &self,
        figure: &Figure,
        region: &Region,
        axis: f64,
        scene: &Scene<'_>,
        moving: &[u8],
        robots: &[Robot],
    ) -> Look {
        let step = self.view.steps_rad(axis, self.raster.height as f64 / 2.0)[0];
        let (mut moves, mut ghosts, mut bodies) = (0usize, 0usize, 0usize);
        for (row, start, len) in region.spans() {
            for m in &moving[row * self.raster.width + start..][..len] {
                moves += usize::from(*m == MOVES);
                ghosts += usize::from(*m == GHOST);
                bodies += usize::from(*m == BODY);
            }
        }
        let most = |pixels: usize| pixels as f64 > 0.5 * region.area as f64;
        let outline = match (most(ghosts), most(bodies)) {
            (true, _) => Outline::Background,
            (_, true) => Outline::Picture,
            _ => Outline::Unclear,
        };
        let alone = figure.own >= ALONE;
        let axis = if alone { axis } else { figure.column };
        let trunk_width = (SHOULDERS_M / figure.range_m).atan() / step;
        let behind =
            |(column, half, _): &Robot| self.raster.column_difference(axis, *column).abs() < half + 0.3 * trunk_width;
        let sighting = Sighting {
            axis,
            axis_sigma: axis_sigma_m(figure).hypot(0.3 * step * figure.range_m) / figure.range_m / step,
            arc: region.arc,
            rows: solid_rows(region, scene, 0..region.arc.width, SOLID_HEAD),
            range_m: figure.range_m,
            trunk_width,
            support: f64::from(figure.support),
            feet_hidden: robots.iter().any(behind),
            head: self.has_head(region, figure.range_m, step),
            alone,
            apart: figure.apart >= ALONE,
            solid: outline == Outline::Picture,
            moves: moves as f64 > MOVING * region.area as f64,
            appearance: looks::appearance(region, scene, &self.view, axis, figure.range_m),
            manner: Manner {
                apart: f64::from(figure.apart),
                support: f64::from(figure.support),
                aside_m: self.raster.column_difference(axis, figure.column) * step * figure.range_m,
            },
        };
        Look { sighting, area: region.area, outline, shaded: shaded(region, scene) }
    }
}

impl Tracker {
    /// Whether a region is as narrow at its top as a head: what begins as broad as shoulders has lost it in what is behind.
    fn has_head(&self, region: &Region, range_m: f64, column_rad: f64) -> bool {
        let top = region.rows[0];
        let row_rad = self.view.steps_rad(region.centroid[0], top as f64)[1];
        let rows = ((HEAD_ROWS_M / range_m / row_rad) as usize).max(2);
        let columns: usize = region.spans().take_while(|(row, ..)| *row < top + rows).map(|(_, _, len)| len).sum();
        columns as f64 / rows as f64 * column_rad * range_m < MOST_HEAD_M
    }
}

/// Of so much from the top on, metres, …
const HEAD_ROWS_M: f64 = 0.15;
/// … the mean breadth of a head is below this and that of shoulders above it, metres.
const MOST_HEAD_M: f64 = 0.28;

/// Lateral error of an axis in the company of others, metres: their marks may be taken for his.
const IN_COMPANY_M: f64 = 0.045;
/// Lateral error of an axis, metres; more where others cover a part.
fn axis_sigma_m(figure: &Figure) -> f64 {
    const COVERED_M: f64 = 0.2;
    IN_COMPANY_M.hypot(COVERED_M * f64::from(1.0 - figure.own.min(1.0)))
}

const MOVES: u8 = 1;
const GHOST: u8 = 2;
const BODY: u8 = 3;

/// For each pixel whether it is in an object that moves, in a ghost, or in what stands out of the background and still stands.
fn mark_moving(scene: &Scene<'_>) -> Vec<u8> {
    let mut marks = vec![0; scene.raster.len()];
    for Object { region, moves, outline } in scene.objects {
        let mark = match (moves, outline) {
            (true, _) => MOVES,
            (_, Outline::Background) => GHOST,
            (_, Outline::Picture) => BODY,
            (_, Outline::Unclear) => continue,
        };
        for (row, start, len) in region.spans() {
            marks[row * scene.raster.width + start..][..len].fill(mark);
        }
    }
    marks
}
