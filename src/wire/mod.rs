//! The wire: other programs read and edit the lights of a running window or of `relume serve`, one JSON object a line.
//! `docs/protocol.md` has the messages.
//!
//! ```text
//! connection -> Server -> Inbound -> Host -> Desk
//! connection <- Server <- answers, events <-┘
//! ```

mod connection_file;
pub mod host;
mod lines;
pub mod message;
pub mod picture;
pub mod server;

pub use self::host::{Host, Other};
pub use self::message::{PROTOCOL, Request};
pub use self::server::{Client, Inbound, Pending, Server};
