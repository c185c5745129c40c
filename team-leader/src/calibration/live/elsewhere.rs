//! What would be known of the standing robots if one of them stood elsewhere.

use nalgebra::{Matrix3, Vector3};
use protocol::frames::Pose2;

use super::Calibrator;
use super::stations::WEAK;
use crate::calibration::block::{Block, Link};
use crate::calibration::kernel;

impl Calibrator {
    /// The standing robots but one; what its sightings told of the others stays known.
    pub fn without(&self, robot: usize) -> Block {
        let mut rest = self.block.clone();
        rest.absorb(&self.links());
        let _ = rest.remove(robot);
        rest
    }

    /// The robot stands at `pose` and sees all of the `rest` and they it, as well as robots see each other at present. `None`
    /// where robots see nothing of each other, or that determines too little.
    pub fn with_elsewhere(&self, rest: &Block, robot: usize, pose: Pose2) -> Option<Block> {
        let links = self.links();
        let widths: Vec<f64> = links.iter().filter_map(|l| Some(l.width_rad?.1)).collect();
        let mean = |values: &mut dyn Iterator<Item = f64>, n: usize| (n > 0).then(|| values.sum::<f64>() / n as f64);
        let bearing_var = mean(&mut links.iter().map(|l| l.bearing_var), links.len())?;
        let width_var = mean(&mut widths.iter().copied(), widths.len());
        let mut block = rest.clone();
        block.insert(robot, pose, &Matrix3::from_diagonal(&Vector3::from(WEAK)));
        let look = |observer: usize, peer: usize| {
            let (from, to) = (block.pose(observer)?, block.pose(peer)?);
            let (from, to) = ([from.x_m, from.y_m, from.heading_rad], [to.x_m, to.y_m]);
            let width = kernel::width(kernel::distance(from, to).0).0 + block.common_width_rad();
            Some(Link {
                observer,
                peer,
                bearing_rad: kernel::bearing(from, to).0,
                bearing_var,
                width_rad: width_var.map(|var| (width, var)),
            })
        };
        let looks: Vec<Link> =
            rest.members().iter().flat_map(|&m| [look(robot, m), look(m, robot)]).flatten().collect();
        block.solve(&looks);
        block.converged().then_some(block)
    }
}
