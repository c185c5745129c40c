//! Learns to tell bodies from shadows: the weights of `robot_agent::tracking::bodily`.
//!
//! Real agents watch rendered rooms; what they marked is compared with what every pixel shows. Rooms, people, lamps and ways are those
//! of the motion cases and of the default scenario, with seeds that nothing else uses; every third room is seen through a camera of half the resolution.

mod learn;

use std::ops::Range;
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;
use robot_agent::agent::{Frame, Input};
use robot_agent::tracking::TrackerSettings;
use robot_agent::tracking::bodily::{self, INPUTS, MarkedCell};

use crate::motion::trial::agent_of;
use crate::motion::{Case, TrialError};
use crate::render::Renderer;
use crate::scenario::Scenario;
use crate::world::World;

/// What is rendered of a seed.
const CASES: [Case; 7] =
    [Case::Meet, Case::TurnBack, Case::Seam, Case::Stroll, Case::Approach, Case::Dusk, Case::Light];
const DEFAULT: &str = "default";
/// Longest piece of a scenario, seconds.
const MOST_S: f64 = 20.0;
/// Every so manieth frame teaches: those between are like them.
const EVERY: usize = 5;
/// Every so manieth room is seen through the camera of half the resolution.
const COARSE: u64 = 3;
/// Of cells that are bodies, of which there are many more than others, this share teaches, and counts for as many more.
const SHARE_OF_BODIES: f64 = 0.2;
/// Steps of learning, however many examples there are: each is seen about ten times.
const STEPS: usize = 40_000;
/// Judged are rooms that were not learnt from: every so manieth.
const FOLDS: u64 = 5;

/// A marked cell and what it shows.
#[derive(Debug, Clone)]
pub struct Example {
    /// What the network sees of it.
    pub inputs: [f32; INPUTS],
    /// Whether that is a person.
    pub is_body: bool,
    /// For how many cells it stands.
    pub weight: f32,
}

/// Examples of one scenario.
#[derive(Debug)]
pub struct Room {
    seed: u64,
    examples: Vec<Example>,
}

/// The scenarios of a seed, one each of which [`gather`] looks at.
pub fn scenarios(seed: u64) -> Vec<Scenario> {
    let cases = CASES.iter().map(|case| case.scenario(seed));
    let default = Scenario::builtin(DEFAULT).and_then(Result::ok);
    cases.chain(default).collect()
}

/// What the robots of a scenario mark, and whether it is people.
///
/// # Errors
/// A world that cannot be, or an agent that does not take its camera.
pub fn gather(mut scenario: Scenario, seed: u64) -> Result<Room, TrialError> {
    if seed.is_multiple_of(COARSE) {
        scenario.camera = scenario.camera.halved();
    }
    let tracking = TrackerSettings { doubts_shadows: false, ..TrackerSettings::default() };
    let world = World::new(&scenario, seed).map_err(|source| TrialError::World { case: "shadows", seed, source })?;
    let world = Arc::new(world);
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    let mut examples = Vec::new();
    for (robot, mut renderer) in world.robots().iter().zip(Renderer::team(&world)) {
        let mut agent = agent_of(&scenario, robot, tracking.clone())?;
        let mut out = Vec::new();
        for (n, capture) in robot.captures.iter().enumerate().filter(|(_, c)| c.true_time_s < MOST_S) {
            let picture = renderer.render(capture.true_time_s);
            let frame =
                Frame { capture: capture.stamp, width: picture.width, height: picture.height, gray: picture.gray };
            agent.handle(capture.stamp, Input::Frame(frame), &mut out);
            out.clear();
            if n % EVERY != 0 {
                continue;
            }
            let people =
                agent.unwarped(&renderer.people(capture.true_time_s)).map_err(|e| TrialError::Camera(e.to_string()))?;
            let width = agent.panorama_width();
            for cell in agent.marked_cells() {
                let Some(is_body) = label(&cell, &people, width) else { continue };
                let weight = if is_body { SHARE_OF_BODIES } else { 1.0 };
                if rng.random::<f64>() < weight {
                    examples.push(Example { inputs: cell.inputs, is_body, weight: 1.0 / weight as f32 });
                }
            }
        }
    }
    Ok(Room { seed, examples })
}

/// Whether a cell shows a person; `None` at outlines, where blur marks what is neither.
fn label(cell: &MarkedCell, people: &[u8], width: usize) -> Option<bool> {
    let shown = |columns: Range<usize>, rows: Range<usize>| -> f32 {
        let rows = rows.filter_map(|row| people.get(row * width..(row + 1) * width));
        let pixels = rows.flat_map(|row| columns.clone().map(move |column| row[column % width]));
        let sum: f32 = pixels.map(|people| f32::from(people) / 255.0).sum();
        sum / (cell.columns.len() * cell.rows.len()) as f32
    };
    if shown(cell.columns.clone(), cell.rows.clone()) > 0.5 * cell.marked {
        return Some(true);
    }
    let [aside, up] = [cell.columns.len(), cell.rows.len()];
    let columns = cell.columns.start + width - aside..cell.columns.end + width + aside;
    (shown(columns, cell.rows.start.saturating_sub(up)..cell.rows.end + up) == 0.0).then_some(false)
}

/// The weights that explain all rooms, and how well such weights tell apart what is in rooms that they were not learnt from.
pub fn learn(rooms: &[Room]) -> (Vec<f32>, String) {
    let is_held_out = |room: &&Room| room.seed.is_multiple_of(FOLDS);
    let all: Vec<&Example> = rooms.iter().flat_map(|room| &room.examples).collect();
    let unseen: Vec<&Example> = rooms.iter().filter(is_held_out).flat_map(|room| &room.examples).collect();
    let seen: Vec<&Example> = rooms.iter().filter(|room| !is_held_out(room)).flat_map(|r| &r.examples).collect();
    let text = judge(&learn::learn(&seen, STEPS), &unseen);
    (learn::learn(&all, STEPS), text)
}

fn judge(net: &[f32], unseen: &[&Example]) -> String {
    let sum = |body: bool, right: &dyn Fn(f32) -> bool| -> f32 {
        let of = unseen.iter().filter(|e| e.is_body == body);
        of.filter(|e| right(bodily::log_odds(net, &e.inputs))).map(|e| e.weight).sum()
    };
    let mut text = format!(
        "{:.0} cells of bodies and {:.0} of other things in rooms unseen\n",
        sum(true, &|_| true),
        sum(false, &|_| true)
    );
    for least in [-2.0, -1.0, 0.0, 1.0, 2.0] {
        let lost = sum(true, &|odds| odds < least) / sum(true, &|_| true).max(1.0);
        let kept = sum(false, &|odds| odds >= least) / sum(false, &|_| true).max(1.0);
        text += &format!(
            "log-odds {least:4.1}: of bodies {:5.2} % lost, of the rest {:5.2} % kept\n",
            100.0 * lost,
            100.0 * kept
        );
    }
    text
}
