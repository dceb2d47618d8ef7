//! A bake in parts, on one machine or on many: what all parts need is made once, then each part; joined, they are the
//! bake.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::prepared::{Prepared, Shared};
use super::progress::{Progress, until_cancelled};
use super::report::BakeReport;
use super::{BakeInput, Session, Transfers};
use crate::bake::cache;
use crate::bake::compression::{Fitted, Part};
use crate::bake::transport::directions::Lobe;
use crate::error::{Error, Result};
use crate::storage::checked::{self, Checked};

/// One part of a bake, in a file.
#[derive(Serialize, Deserialize)]
struct BakedPart {
    /// What the deep framebuffer depends on.
    inputs: cache::Inputs,
    /// The bakes of indirect light, and of light of the sky if there is a dome.
    key: cache::Key,
    sky_key: Option<cache::Key>,
    part: Part,
    /// Checksum of the file that parts share. Processors with other vector instructions may make another one.
    shared: [u8; 32],
    fits: Vec<Fitted>,
    sky_fits: Vec<Fitted>,
}

/// Pictures use all lobes. The transfer of the specular lobe alone is a bake of its own and cannot be divided.
const LOBE: Lobe = Lobe::All;

impl Session {
    /// Makes what all parts of the bake need, and keeps it in the cache, unless that or the whole bake is there.
    pub fn share(&mut self, progress: &dyn Progress) -> Result<()> {
        self.in_parts(|transfers, input, report| match transfers.is_complete() {
            true => Ok(()),
            false => transfers.share(input, report, progress).map(drop),
        })
    }

    /// Bakes one part to `output`, or to the cache. Returns the file; `None` if the cache has the whole bake, and no
    /// file is asked for.
    pub fn bake_part(&mut self, part: Part, output: Option<&Path>, progress: &dyn Progress) -> Result<Option<PathBuf>> {
        self.in_parts(|transfers, input, report| transfers.bake_part(input, part, output, report, progress))
    }

    /// Makes the bake from all its parts, and keeps it in the cache: the same bytes as if it was baked at once. Without
    /// `parts` from those in the cache, which it then removes.
    pub fn join(&mut self, parts: &[PathBuf], progress: &dyn Progress) -> Result<()> {
        self.in_parts(|transfers, input, report| transfers.join(input, parts, report, progress))?;
        if self.bake.not_stored.is_none() {
            self.transfer = Some(self.transfer(LOBE, progress)?.into());
        }
        Ok(())
    }

    fn in_parts<R>(&mut self, work: impl FnOnce(&Transfers, BakeInput, &mut BakeReport) -> Result<R>) -> Result<R> {
        let Self { scene, framebuffer, bake, transfers, plain, .. } = self;
        let refuse = |reason: &str| Err(Error::invalid("a bake in parts", reason));
        match transfers {
            None => refuse("there is nothing to divide without indirect light: leave out --gi off"),
            Some(transfers) if !transfers.plan.is_divisible() => {
                refuse("only nested blocks can be divided: leave out --method and --transfer")
            }
            Some(transfers) => {
                let input = BakeInput { scene, framebuffer: plain.as_ref().unwrap_or(framebuffer) };
                bake.clocked(|report| until_cancelled(|| work(transfers, input, report)))
            }
        }
    }
}

impl Transfers {
    /// Returns the file of what parts share, and makes it if it is not there or damaged.
    fn share(&self, input: BakeInput, report: &mut BakeReport, progress: &dyn Progress) -> Result<PathBuf> {
        let no_cache = || Error::invalid("a bake in parts", "parts share a file of the cache, and there is no cache");
        let path = self.shared_file(LOBE).ok_or_else(no_cache)?;
        if path.exists() {
            match self.restore(&path, input, report) {
                Ok(_) => return Ok(path),
                Err(error) => tracing::warn!("made again: {}", error.chain()),
            }
        }
        let prepared = self.plan.prepare(input, report, progress);
        progress.begin("training lights", 0);
        let write = |shared: &Shared| checked::write(&path, &cache::kind("shared by parts"), shared);
        let made = report.stage("training lights", || prepared.share(LOBE, self.has_sky(), write));
        progress.end();
        made.map(|()| path)
    }

    fn bake_part(
        &self,
        input: BakeInput,
        part: Part,
        output: Option<&Path>,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<Option<PathBuf>> {
        if output.is_none() && self.is_complete() {
            return Ok(None);
        }
        let shared = self.share(input, report, progress)?;
        let key = self.key(LOBE);
        let path = output.map_or_else(|| self.part_file(&key, part, "part"), Path::to_owned);
        if output.is_none() && self.read_part(&path).is_ok() {
            return Ok(Some(path));
        }
        let (mut prepared, shared) = self.restore(&shared, input, report)?;
        let sky_key = self.has_sky().then(|| self.sky_key(LOBE));
        let journal = self.part_file(&key, part, "journal");
        let fits = prepared.bake_part(LOBE, part, &journal, report, progress)?;
        let sky_journal = sky_key.as_ref().map(|key| self.part_file(key, part, "journal"));
        let sky_fits = match &sky_journal {
            Some(journal) => prepared.bake_part_of_sky(LOBE, part, journal, report, progress)?,
            None => Vec::new(),
        };
        let made = BakedPart { inputs: self.inputs.clone(), key, sky_key, part, shared, fits, sky_fits };
        report.stage("write part", || checked::write(&path, &cache::kind("part of a bake"), &made))?;
        // A journal that remains is removed by `relume bake --prune`.
        [Some(journal), sky_journal].iter().flatten().for_each(|path| drop(std::fs::remove_file(path)));
        Ok(Some(path))
    }

    fn join(
        &self,
        input: BakeInput,
        paths: &[PathBuf],
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Result<()> {
        let in_cache = match paths.is_empty() {
            // An earlier join may not have removed all of them.
            true if self.is_sound(input) => return self.remove_parts(&self.found_parts()?),
            true => self.parts_in_cache()?,
            false => Vec::new(),
        };
        let mut parts = Vec::new();
        for path in paths.iter().chain(&in_cache) {
            parts.push((path, self.read_part(path)?));
        }
        check_all_there(&parts.iter().map(|(path, part)| (&***path, part.part)).collect::<Vec<_>>())?;
        if let Some((path, _)) = parts.iter().find(|(_, part)| part.shared != parts[0].1.shared) {
            let reason = "this part was baked with another shared file than the first one: let all parts use one";
            return Err(Error::import(path, reason));
        }
        let [mut fits, mut sky_fits] = [Vec::new(), Vec::new()];
        for (_, part) in parts {
            fits.extend(part.fits);
            sky_fits.extend(part.sky_fits);
        }
        for fits in [&mut fits, &mut sky_fits] {
            fits.sort_by_key(|fitted| fitted.tiles.start);
        }
        self.get(input, LOBE, [Some(fits), Some(sky_fits)], &|_| (), report, progress)?;
        if report.not_stored.is_none() { self.remove_parts(&in_cache) } else { Ok(()) }
    }

    /// Removes what a bake in parts left in the cache.
    fn remove_parts(&self, parts: &[PathBuf]) -> Result<()> {
        // What remains is removed by `relume bake --prune`.
        self.shared_file(LOBE).iter().chain(parts).for_each(|path| drop(std::fs::remove_file(path)));
        Ok(())
    }

    /// Whether the cache has the whole bake.
    fn is_complete(&self) -> bool {
        let has = |key| self.dir.as_deref().is_some_and(|dir| cache::has(dir, &key));
        has(self.key(LOBE)) && (!self.has_sky() || has(self.sky_key(LOBE)))
    }

    /// Whether the whole bake can be read from the cache.
    fn is_sound(&self, input: BakeInput) -> bool {
        let Some(dir) = self.dir.as_deref().filter(|_| self.is_complete()) else { return false };
        cache::load_transfer(dir, &self.key(LOBE), input.framebuffer).is_some()
            && (!self.has_sky() || cache::load_sky(dir, &self.sky_key(LOBE), input.framebuffer).is_some())
    }

    /// The files of all parts in the cache, of whatever division.
    fn found_parts(&self) -> Result<Vec<PathBuf>> {
        let Some(dir) = &self.dir else { return Ok(Vec::new()) };
        Ok(cache::parts(dir, &self.key(LOBE))?.into_iter().map(|(_, path)| path).collect())
    }

    /// The files of all parts. If the cache has parts of several divisions, those of one that is complete.
    fn parts_in_cache(&self) -> Result<Vec<PathBuf>> {
        let Some(dir) = &self.dir else {
            return Err(Error::invalid("--join", "there is no cache: name the files of the parts"));
        };
        let found = cache::parts(dir, &self.key(LOBE))?;
        let of = |count: usize| found.iter().filter(move |(part, _)| part.count == count);
        let counts = found.iter().map(|(part, _)| part.count);
        match counts.clone().find(|&count| of(count).count() == count).or(counts.max()) {
            Some(count) => Ok(of(count).map(|(_, path)| path.clone()).collect()),
            None => Err(Error::invalid("--join", format!("{} has no parts of this bake", dir.display()))),
        }
    }

    /// Fails if the file is no part of this bake.
    fn read_part(&self, path: &Path) -> Result<BakedPart> {
        let (part, _): (BakedPart, _) = checked::read(path, &cache::kind("part of a bake"))?;
        let refuse = |reason: String| Err(Error::import(path, format!("this is a part of another bake: {reason}")));
        match self.inputs.changes_since(&part.inputs)[..] {
            [] if part.key != self.key(LOBE) => refuse("options of indirect light differ".into()),
            [] if self.has_sky() && part.sky_key.is_none() => refuse("its lights had no dome".into()),
            [] => Ok(part),
            ref changes => refuse(format!("these differ: {}", changes.join(", "))),
        }
    }

    /// What the operator is made from: what parts share, if it is in the cache, or else computed.
    pub(super) fn prepare<'a>(
        &'a self,
        input: BakeInput<'a>,
        lobe: Lobe,
        report: &mut BakeReport,
        progress: &dyn Progress,
    ) -> Prepared<'a> {
        if let Some(path) = self.shared_file(lobe).filter(|path| path.exists()) {
            match self.restore(&path, input, report) {
                Ok((prepared, _)) => return prepared,
                Err(error) => tracing::warn!("{}: computing it again", error.chain()),
            }
        }
        self.plan.prepare(input, report, progress)
    }

    /// The same from the shared file, with its checksum.
    fn restore<'a>(
        &'a self,
        path: &Path,
        input: BakeInput<'a>,
        report: &mut BakeReport,
    ) -> Result<Checked<Prepared<'a>>> {
        let read = || checked::read_mapped(path, &cache::kind("shared by parts"));
        let (shared, checksum) = report.stage("read cache", read)?;
        Ok((self.plan.restore(input, shared, self.has_sky()), checksum))
    }

    /// With light of the sky it is another file.
    fn shared_file(&self, lobe: Lobe) -> Option<PathBuf> {
        let key = if self.has_sky() { self.sky_key(lobe) } else { self.key(lobe) };
        self.dir.as_ref().map(|dir| cache::file_of(dir, &key, "shared"))
    }

    /// Panics without a cache.
    fn part_file(&self, key: &cache::Key, part: Part, extension: &str) -> PathBuf {
        cache::file_of_part(self.dir.as_ref().expect("there is a cache"), key, part, extension)
    }
}

/// Fails unless each part of a bake is there once.
fn check_all_there(parts: &[(&Path, Part)]) -> Result<()> {
    let refuse = |reason: String| Err(Error::invalid("--join", reason));
    let Some((first, Part { count, .. })) = parts.first() else { return refuse("there is no part".into()) };
    if let Some((other, part)) = parts.iter().find(|(_, part)| part.count != *count) {
        let [first, other] = [first, other].map(|path| path.display());
        return refuse(format!("{first} is one of {count} parts, {other} one of {}", part.count));
    }
    for number in 1..=*count {
        let mut found = parts.iter().filter(|(_, part)| part.number == number).map(|(path, _)| path.display());
        match (found.next(), found.next()) {
            (None, _) => return refuse(format!("part {number}/{count} is missing")),
            (Some(one), Some(other)) => return refuse(format!("part {number}/{count} is there twice: {one}, {other}")),
            _ => {}
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_part_must_be_there_once() {
        let told = |parts: &[&str]| {
            let parts: Vec<_> = parts.iter().map(|part| (Path::new(part), part.parse().unwrap())).collect();
            check_all_there(&parts).map_or_else(|error| error.to_string(), |()| String::new())
        };
        assert_eq!(told(&["2/3", "1/3", "3/3"]), "");
        assert_eq!(told(&["1/1"]), "");
        assert_eq!(told(&[]), "--join: there is no part");
        assert_eq!(told(&["1/3", "3/3"]), "--join: part 2/3 is missing");
        assert_eq!(told(&["1/2", "2/2", "1/2"]), "--join: part 1/2 is there twice: 1/2, 1/2");
        assert_eq!(told(&["1/2", "2/3"]), "--join: 1/2 is one of 2 parts, 2/3 one of 3");
    }
}
