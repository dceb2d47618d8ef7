//! Other programs that edit lights: through `relume serve`, and beside the hands of a person in the window.

#[path = "../command/mod.rs"]
mod command;
#[path = "../common/mod.rs"]
mod common;
#[path = "../desktop/mod.rs"]
mod desktop;

mod client;
mod hostile;
mod patches;
mod serving;
mod window;
