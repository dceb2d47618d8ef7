//! Other programs that edit lights: through `relume serve`, and beside the hands of a person in the window.

#[path = "../command/mod.rs"]
mod command;
#[path = "../desktop/mod.rs"]
mod desktop;

#[allow(dead_code)] // other tests use the rest of it
#[path = "../common/random.rs"]
mod random;

mod client;
mod hostile;
mod patches;
mod serving;
mod window;
