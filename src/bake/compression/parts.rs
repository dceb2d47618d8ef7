//! Superclusters divided among the parts of a bake.

use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// One of the parts of a bake, written `number/count`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    /// 1 to `count`.
    pub number: usize,
    pub count: usize,
}

/// Most parts of a bake: a picture has some hundred superclusters.
pub const MAX_PARTS: usize = 1024;

impl FromStr for Part {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers =
            text.split_once('/').and_then(|(number, count)| Some((number.parse().ok()?, count.parse().ok()?)));
        match numbers {
            Some((number, count)) if (1..=count).contains(&number) && count <= MAX_PARTS => Ok(Self { number, count }),
            _ => Err(format!("expected I/N, like 2/7: part I of N, with I from 1 to N and N at most {MAX_PARTS}")),
        }
    }
}

impl std::fmt::Display for Part {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}/{}", self.number, self.count)
    }
}

impl Part {
    /// Which of some items are in this part, ascending, if parts are to have equal sums of costs: the largest item goes
    /// to the part that has the least [Graham 1969].
    pub fn of(&self, costs: &[f64]) -> Vec<usize> {
        let mut order: Vec<usize> = (0..costs.len()).collect();
        order.sort_by(|&i, &j| costs[j].total_cmp(&costs[i]));
        let mut sums = vec![0.0; self.count];
        let mut own = Vec::new();
        for item in order {
            let least = (0..self.count).min_by(|&i, &j| f64::total_cmp(&sums[i], &sums[j])).expect("there is a part");
            sums[least] += costs[item];
            own.extend((least + 1 == self.number).then_some(item));
        }
        own.sort_unstable();
        own
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_read_as_they_are_written() {
        assert_eq!("2/7".parse(), Ok(Part { number: 2, count: 7 }));
        assert_eq!(Part { number: 2, count: 7 }.to_string(), "2/7");
        for wrong in ["", "2", "0/7", "8/7", "1/0", "-1/2", "1/2/3", "a/b", "1/1025"] {
            assert!(wrong.parse::<Part>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn every_item_is_in_one_part_and_parts_are_equal() {
        let costs: Vec<f64> = (0..100).map(|i| 1.0 + f64::from(i * 37 % 100) / 25.0).collect();
        let all: f64 = costs.iter().sum();
        for count in [1, 2, 7, 16] {
            let parts: Vec<Vec<usize>> = (1..=count).map(|number| Part { number, count }.of(&costs)).collect();
            let mut items = parts.concat();
            items.sort_unstable();
            assert_eq!(items, (0..100).collect::<Vec<_>>());
            for part in parts {
                let sum: f64 = part.iter().map(|&item| costs[item]).sum();
                assert!((sum * count as f64 / all - 1.0).abs() < 0.05, "{count} parts: {sum} of {all}");
            }
        }
        assert_eq!(Part { number: 3, count: 3 }.of(&[1.0, 1.0]), [0; 0]);
    }
}
