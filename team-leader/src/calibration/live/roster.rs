//! The robots of one calibration, by the leader's numbers.

use std::ops::{Index, IndexMut};

use super::robots::Robot;

/// Robots by number. Of a large team a calibration may have a few: only these are gone through.
#[derive(Debug, Clone, Default)]
pub struct Roster {
    /// In ascending order.
    numbers: Vec<usize>,
    robots: Vec<Robot>,
}

impl Roster {
    /// Adds a robot, or replaces what is known of it.
    pub fn insert(&mut self, number: usize, robot: Robot) {
        match self.numbers.binary_search(&number) {
            Ok(k) => self.robots[k] = robot,
            Err(k) => {
                self.numbers.insert(k, number);
                self.robots.insert(k, robot);
            }
        }
    }

    /// Takes a robot out.
    pub fn remove(&mut self, number: usize) -> Option<Robot> {
        let k = self.numbers.binary_search(&number).ok()?;
        self.numbers.remove(k);
        Some(self.robots.remove(k))
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.numbers.len()
    }

    /// Numbers, ascending.
    pub fn numbers(&self) -> impl Iterator<Item = usize> + '_ {
        self.numbers.iter().copied()
    }

    /// Numbers and robots, ascending.
    pub fn iter(&self) -> impl Iterator<Item = (usize, &Robot)> {
        self.numbers().zip(&self.robots)
    }

    /// The robots, ascending by number.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut Robot> {
        self.robots.iter_mut()
    }

    /// A robot, where it is one of these.
    pub fn get(&self, number: usize) -> Option<&Robot> {
        self.numbers.binary_search(&number).ok().map(|k| &self.robots[k])
    }

    /// The same, to be changed.
    pub fn get_mut(&mut self, number: usize) -> Option<&mut Robot> {
        self.numbers.binary_search(&number).ok().map(|k| &mut self.robots[k])
    }

    fn place(&self, number: usize) -> usize {
        self.numbers.binary_search(&number).unwrap_or_else(|_| panic!("robot {number} is not of this calibration"))
    }
}

impl Index<usize> for Roster {
    type Output = Robot;

    /// A robot of these.
    fn index(&self, number: usize) -> &Robot {
        &self.robots[self.place(number)]
    }
}

impl IndexMut<usize> for Roster {
    fn index_mut(&mut self, number: usize) -> &mut Robot {
        let k = self.place(number);
        &mut self.robots[k]
    }
}
