//! RL-Glue's skeleton environment, a walk along 21 states, from the middle to either end.
//!
//! `glue-experiment --agent random --episodes 10`, and beside it: `cargo run --release --example skeleton`

use glue_rl::{serve_environment, Action, Environment, Error, Observation, Options, Outcome, Step};

const FIRST: i32 = 10;
const LAST: i32 = 20;

/// Action 0 goes down, 1 goes up; state 0 ends with the reward -1, state 20 with +1.
struct Walk {
    state: i32,
}

impl Environment for Walk {
    fn init(&mut self) -> Outcome<String> {
        Ok("VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 \
            OBSERVATIONS INTS (0 20) ACTIONS INTS (0 1) REWARDS (-1.0 1.0) EXTRA skeleton"
            .to_owned())
    }

    fn start(&mut self) -> Outcome<Observation> {
        self.state = FIRST;
        Ok([self.state].into())
    }

    fn step(&mut self, action: &Action) -> Outcome<Step> {
        let action = action.ints.first().ok_or("an action is one int")?;
        self.state += if *action == 1 { 1 } else { -1 };
        let reward = match self.state {
            0 => -1.0,
            LAST => 1.0,
            _ => 0.0,
        };
        Ok(Step { reward, terminal: reward != 0.0, observation: [self.state].into(), truncated: false })
    }

    fn message(&mut self, _: &str) -> Outcome<String> {
        Ok("I don't know how to respond to your message".to_owned())
    }
}

fn main() -> Result<(), Error> {
    println!("{}", serve_environment(&mut Walk { state: FIRST }, &Options::named("skeleton"))?);
    Ok(())
}
