//! RL-Glue for Rust: agents, environments and experiments as programs of their own.
//!
//! ```no_run
//! use glue_rl::{serve_agent, Action, Agent, Observation, Options, Outcome};
//!
//! struct Walker;
//!
//! impl Agent for Walker {
//!     fn start(&mut self, _: &Observation) -> Outcome<Action> {
//!         Ok([1].into())
//!     }
//!     fn step(&mut self, _reward: f64, _: &Observation) -> Outcome<Action> {
//!         Ok([1].into())
//!     }
//! }
//!
//! fn main() -> Result<(), glue_rl::Error> {
//!     serve_agent(&mut Walker, &Options::named("walker")).map(|goodbye| println!("{goodbye}"))
//! }
//! ```
//!
//! A hub that is not there yet is waited for; a connection that breaks is made again, and the episode goes on. The library
//! speaks ZeroMQ's protocol itself, over `tcp` and Unix sockets (`ipc`), without encryption.

#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod abstract_type;
mod dealer;
mod error;
mod experiment;
mod extras;
mod link;
mod masks;
mod message;
mod msgpack;
mod options;
mod player;
mod roles;
mod zmtp;

#[cfg(test)]
mod tests;

pub use abstract_type::{AbstractType, Action, Observation};
pub use error::Error;
pub use experiment::{Experiment, Start, Transition};
pub use extras::{Extra, Extras};
pub use options::Options;
pub use player::{serve_agent, serve_environment};
pub use roles::{Agent, Capability, Environment, Outcome, Step};
