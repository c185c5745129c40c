//! Whether a map shows the rooms as they are: each component in a frame of its own, laid over the truth by its first robot.

use nalgebra::Vector2;
use protocol::frames::Pose2;
use protocol::message::TeamMap;

use super::ROOM;
use super::room::Room;

/// A robot is where it should be this near, metres, and a person as the scores have it.
const ROBOT_M: f64 = 0.05;
const PERSON_M: f64 = 0.5;

/// Robots and people that a map of these rooms shows where they are. A robot in one component with those of another room does not
/// count, nor does a second target on one person.
pub fn right(map: &TeamMap, rooms: &[Room]) -> [usize; 2] {
    let mut right = [0, 0];
    for component in map.components() {
        let numbers: Vec<(usize, Pose2)> = map
            .placed(component)
            .filter_map(|robot| Some((robot.id.as_str().trim_start_matches('r').parse().ok()?, robot.team_from_body?)))
            .collect();
        let Some(&(first, pose)) = numbers.first() else { continue };
        let Some(room) = rooms.get(first / ROOM) else { continue };
        let [x, y, heading] = room.robot(first % ROOM);
        let room_from_team = Pose2::new(x, y, heading) * pose.inverse();
        for (robot, pose) in numbers.iter().filter(|(robot, _)| robot / ROOM == first / ROOM) {
            let [x, y, _] = room.robot(robot % ROOM);
            let away_m = (room_from_team.transform(pose.position()) - Vector2::new(x, y)).norm();
            right[0] += usize::from(away_m < ROBOT_M);
        }
        let mut targets: Vec<Vector2<f64>> = map
            .targets
            .iter()
            .filter(|target| target.component == component)
            .map(|target| room_from_team.transform(Vector2::new(target.position_m[0], target.position_m[1])))
            .collect();
        for person in room.truth(map.stamp).people {
            let at = Vector2::new(person.x_m, person.y_m);
            let nearest =
                (0..targets.len()).min_by(|a, b| (targets[*a] - at).norm().total_cmp(&(targets[*b] - at).norm()));
            if let Some(k) = nearest.filter(|k| (targets[*k] - at).norm() < PERSON_M) {
                targets.swap_remove(k);
                right[1] += 1;
            }
        }
    }
    right
}
