//! An agent that acts at random within the bounds of the task spec: Infinite Mario, or any task with ints as actions.
//! Where the environment says which actions are legal, it chooses among them.
//!
//! `glue-experiment --env mario --episodes 10`, and beside it: `cargo run --release --example random`

use glue_rl::{serve_agent, Action, Agent, Capability, Error, Observation, Options, Outcome};

/// Numerical Recipes' linear congruential generator: 32 bits of state, of which the upper 16 are drawn.
#[derive(Default)]
struct Generator {
    state: u32,
}

impl Generator {
    /// Returns a number from 0 to n - 1.
    fn draw(&mut self, n: i32) -> i32 {
        self.state = self.state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.state >> 16) as i32 % n
    }
}

#[derive(Default)]
struct RandomAgent {
    generator: Generator,
    /// The lowest and the highest value of each int of an action.
    bounds: Vec<(i32, i32)>,
}

impl RandomAgent {
    fn act(&mut self, observation: &Observation) -> Outcome<Action> {
        let mut numbers = 0..; // of the values of all ints, one int after another
        let mut ints = Vec::new();
        for (low, high) in &self.bounds {
            let values = (*low..=*high).zip(&mut numbers);
            let legal: Vec<_> = values.filter(|(_, number)| observation.legal(*number)).collect();
            if legal.is_empty() {
                return Err("an int of the action has no legal value".into());
            }
            ints.push(legal[self.generator.draw(legal.len() as i32) as usize].0);
        }
        Ok(ints.into())
    }
}

impl Agent for RandomAgent {
    fn capabilities(&self) -> &[Capability] {
        &[Capability::Seed]
    }

    fn seed(&mut self, seed: u64) -> Outcome<()> {
        self.generator.state = seed as u32; // the lower 32 bits
        Ok(())
    }

    fn init(&mut self, task_spec: &str) -> Outcome<()> {
        self.bounds = bounds_of(task_spec).unwrap_or_default();
        Ok(())
    }

    fn start(&mut self, observation: &Observation) -> Outcome<Action> {
        self.act(observation)
    }

    fn step(&mut self, _: f64, observation: &Observation) -> Outcome<Action> {
        self.act(observation)
    }
}

/// Returns the bounds of each int of an action: `ACTIONS INTS (-1 1) (2 0 1)` are three.
fn bounds_of(task_spec: &str) -> Option<Vec<(i32, i32)>> {
    let actions = task_spec.split_once("ACTIONS")?.1.trim_start().strip_prefix("INTS")?;
    let mut bounds = Vec::new();
    let mut rest = actions.trim_start();
    while let Some((range, after)) = rest.strip_prefix('(').and_then(|rest| rest.split_once(')')) {
        let numbers: Vec<i32> = range.split_whitespace().map_while(|word| word.parse().ok()).collect();
        match numbers[..] {
            [low, high] => bounds.push((low, high)),
            [count, low, high] => (0..count).for_each(|_| bounds.push((low, high))),
            _ => return None,
        }
        rest = after.trim_start();
    }
    Some(bounds)
}

fn main() -> Result<(), Error> {
    println!("{}", serve_agent(&mut RandomAgent::default(), &Options::named("random"))?);
    Ok(())
}
