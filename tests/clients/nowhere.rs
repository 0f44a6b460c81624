// An environment whose second mask leaves the second int of an action no legal value.
use glue_rl::{serve_environment, Action, Environment, Error, Observation, Options, Outcome, Step};

struct Nowhere;

fn masked(somewhere: bool) -> Observation {
    Observation { mask: vec![false, true, false, somewhere, false], ..[0].into() }
}

impl Environment for Nowhere {
    fn init(&mut self) -> Outcome<String> { Ok("TASK_SPEC".to_owned()) }
    fn start(&mut self) -> Outcome<Observation> { Ok(masked(true)) }
    fn step(&mut self, _: &Action) -> Outcome<Step> {
        Ok(Step { observation: masked(false), ..Step::default() })
    }
}

fn main() -> Result<(), Error> {
    serve_environment(&mut Nowhere, &Options::named("nowhere")).map(|_| ())
}
