//! Final gathering in an open scene.

use super::OpenScene;
use crate::error::Result;
use crate::gpu::is_out_of_memory;
use crate::view::refine::gathered::{Gathered, GatheringState};

impl OpenScene {
    /// Accepts indirect light that was gathered; `None`: gathering failed.
    pub fn accept_gathered(&mut self, gathered: Option<Gathered>) -> Result<()> {
        let Some(gathered) = gathered else {
            self.give_up_gathering("it failed; the reason is on the terminal");
            return Ok(());
        };
        let outcome = self.final_gathering.accept(gathered, &self.opened, &self.relighter);
        self.without_gathering_if(outcome)
    }

    /// Goes on without final gathering if the device has no room for it: the picture remains as it is.
    fn without_gathering_if(&mut self, outcome: Result<()>) -> Result<()> {
        match outcome {
            Err(error) if is_out_of_memory(&error) => {
                self.give_up_gathering(&error.to_string());
                Ok(())
            }
            outcome => outcome,
        }
    }

    fn give_up_gathering(&mut self, reason: &str) {
        tracing::warn!("indirect light is not gathered at rest: {reason}");
        self.waits_for_operator = false;
        self.final_gathering.give_up();
    }

    /// How far final gathering has come.
    pub fn gathering(&self) -> GatheringState {
        self.final_gathering.state()
    }

    /// Whether the first indirect light is about to come: nothing else takes time from it.
    pub(super) fn waits_for_indirect(&self) -> bool {
        self.is_baking && self.opened.transfer.is_none()
    }

    pub(super) fn gather_step(&mut self) -> Result<()> {
        self.sync_lights()?;
        let met = self.final_gathering.step(&self.opened, &mut self.relighter, self.is_baking);
        if let Ok(Some(error)) = &met
            && *error > 0.0
        {
            self.desk.message = format!("expected error {:.1} %", 100.0 * error);
        }
        self.without_gathering_if(met.map(|_| ()))
    }
}
