//! How much of each robot is seen, and where people are, by the picture's own bookkeeping of what every pixel shows.

use super::Renderer;
use super::body_at;
use super::still::robot_of;

/// A robot in a picture: pixels of the part that carries its marker, within the design's field of view.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Presence {
    /// It would cover alone.
    pub alone: u32,
    /// It covers.
    pub seen: u32,
}

impl Presence {
    /// Unhidden share, 0 where nothing of it is in the field of view.
    pub fn visible(&self) -> f64 {
        f64::from(self.seen) / f64::from(self.alone.max(1))
    }
}

impl Renderer {
    /// The pixels of a picture that show a person at a true time: 255 where one does, else 0.
    pub fn people(&mut self, time_s: f64) -> Vec<u8> {
        let state = self.world.at(time_s);
        self.look_from(&state);
        let movers = self.movers(&state);
        self.draw(&movers);
        let mut shown = vec![0; self.rays.width * self.rays.height];
        for pixel in self.canvas.touched.iter().map(|p| *p as usize) {
            if movers[usize::from(self.canvas.shown[pixel].0)].person_index().is_some() {
                shown[pixel] = u8::MAX;
            }
        }
        self.clear();
        self.inner(&shown)
    }

    /// Of every robot of the world at a true time; nothing for the observer itself and for robots that drive.
    pub fn presence(&mut self, time_s: f64) -> Vec<Presence> {
        let state = self.world.at(time_s);
        self.look_from(&state);
        let movers = self.movers(&state);
        self.draw(&movers);
        let mut presence = vec![Presence::default(); self.world.robots().len()];
        for (n, found) in presence.iter_mut().enumerate() {
            let Some(caster) = self.standing.iter().position(|c| usize::from(c.body) == n + 1) else { continue };
            let body = body_at(&self.world, &state, n);
            for part in (0..body.parts()).filter(|part| body.is_marker(*part)) {
                for pixel in self.rays.window(&self.still.stand, &body.bound(part)).filter(|p| self.rays.is_nominal[*p])
                {
                    let ray = self.still.ray[pixel];
                    if body.hit(part, &ray, f32::INFINITY).is_none() {
                        continue;
                    }
                    found.alone += 1;
                    let is_free = self.canvas.key[pixel] == 0;
                    found.seen += u32::from(is_free && robot_of(self.still.key[pixel]) == Some((caster, part)));
                }
            }
        }
        self.clear();
        presence
    }
}
