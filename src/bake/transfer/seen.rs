//! Which gather samples matter: those whose light a pixel sees, straight or over bounces.

use super::Transfer;
use super::level::Level;
use super::rows::Rows;

/// A flag for each gather sample.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seen {
    pub fine: Vec<bool>,
    /// Empty with one level.
    pub coarse: Vec<bool>,
}

impl Transfer<'_> {
    /// Which samples a picture depends on, from the columns of Φ that any of its rows has an entry in, one flag for each
    /// of [`Transfer::column_count`]: light at the others never reaches a pixel, so nobody needs to shade them.
    pub fn seen(&self, columns: &[bool]) -> Seen {
        assert_eq!(columns.len(), self.column_count(), "a flag a column");
        let (fine, coarse) = columns.split_at(self.fine.coefficient_count());
        match (&self.coarse, &self.from_fine) {
            (Some(level), Some(from_fine)) => {
                let coarse = behind(&self.among, coarse.to_vec());
                let mut fine = fine.to_vec();
                senders(from_fine, &coarse, |column| fine[column] = true);
                Seen { fine: by_sample(&self.fine, &fine), coarse: by_sample(level, &coarse) }
            }
            _ => Seen { fine: by_sample(&self.fine, &behind(&self.among, fine.to_vec())), coarse: Vec::new() },
        }
    }
}

/// All coefficients that send light to `reached` ones over any number of bounces, and those themselves.
fn behind(g: &Rows, mut reached: Vec<bool>) -> Vec<bool> {
    let mut fresh = reached.clone();
    while fresh.contains(&true) {
        let mut next = vec![false; reached.len()];
        senders(g, &fresh, |column| next[column] = !reached[column]);
        reached.iter_mut().zip(&next).for_each(|(reached, next)| *reached |= next);
        fresh = next;
    }
    reached
}

/// Calls `visit` with every coefficient that sends light to one of `receivers`.
fn senders(rows: &Rows, receivers: &[bool], mut visit: impl FnMut(usize)) {
    for row in (0..rows.len()).filter(|&row| receivers[row]) {
        let sends = |(_, value): &(u32, [f32; 3])| *value != [0.0; 3];
        rows.row(row).filter(sends).for_each(|(column, _)| visit(column as usize));
    }
}

fn by_sample(level: &Level, coefficients: &[bool]) -> Vec<bool> {
    (0..level.samples.len()).map(|sample| coefficients[level.coefficients(sample)].contains(&true)).collect()
}
