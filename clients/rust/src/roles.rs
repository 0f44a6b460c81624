use crate::{Action, Observation};

/// What the methods of a player return: any error will do, and is reported to the hub.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// What a player can do beyond the basic calls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Capability {
    /// It can be given a number from which it draws all its random choices.
    Seed,
    /// It can be saved and loaded between episodes.
    Save,
    /// An agent that has numbers of its own.
    Metrics,
    /// An agent that is told how much time it has, where the environment does not wait for it.
    Pace,
}

/// An agent: it learns.
pub trait Agent {
    /// Returns what this agent can do beyond the basic calls: whoever implements `seed`, or `save` and `load`, says so.
    fn capabilities(&self) -> &[Capability] {
        &[]
    }

    /// Prepares for a task; what was learned before is forgotten.
    fn init(&mut self, _task_spec: &str) -> Outcome<()> {
        Ok(())
    }

    /// Begins an episode: takes its first observation, returns the first action.
    fn start(&mut self, observation: &Observation) -> Outcome<Action>;

    /// Takes the reward of the last action and the observation after it, returns the next action.
    fn step(&mut self, reward: f64, observation: &Observation) -> Outcome<Action>;

    /// Takes the last reward of an episode that has reached its end.
    fn end(&mut self, _reward: f64) -> Outcome<()> {
        Ok(())
    }

    /// Releases what `init` acquired; another `init` may follow.
    fn cleanup(&mut self) -> Outcome<()> {
        Ok(())
    }

    /// Answers a text with a text; may come at any time.
    fn message(&mut self, _text: &str) -> Outcome<String> {
        Ok(String::new())
    }

    /// Draws all random choices from this number from now on (0 to 2^63 - 1); comes before `init`.
    fn seed(&mut self, _seed: u64) -> Outcome<()> {
        Err("this agent cannot be seeded".into())
    }

    /// Returns everything that later episodes depend on.
    fn save(&mut self) -> Outcome<Vec<u8>> {
        Err("this agent cannot be saved".into())
    }

    /// Goes on from what `save` returned, after `init`; check it, it may come from someone else.
    fn load(&mut self, _data: &[u8]) -> Outcome<()> {
        Err("this agent cannot be loaded".into())
    }

    /// Returns numbers of the agent, such as its step size, with their names of 1 to 64 characters without line breaks.
    fn metrics(&self) -> Outcome<Vec<(String, f64)>> {
        Err("this agent has no metrics".into())
    }

    /// Takes, before a `step`, the seconds until the environment's next step, and those that the last answer took.
    fn pace(&mut self, _deadline: f64, _latency: f64) -> Outcome<()> {
        Ok(())
    }
}

/// The outcome of an action.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Step {
    /// The reward.
    pub reward: f64,
    /// Whether the episode is over.
    pub terminal: bool,
    /// The observation after the action.
    pub observation: Observation,
    /// Whether it is over only because it was cut off, in a state that is not terminal: the agent is shown the observation,
    /// and no end.
    pub truncated: bool,
}

/// An environment: the task.
pub trait Environment {
    /// Returns what this environment can do beyond the basic calls.
    fn capabilities(&self) -> &[Capability] {
        &[]
    }

    /// Prepares; returns the task spec, which describes observations, actions and rewards.
    fn init(&mut self) -> Outcome<String>;

    /// Begins an episode; returns its first observation.
    fn start(&mut self) -> Outcome<Observation>;

    /// Executes an action.
    fn step(&mut self, action: &Action) -> Outcome<Step>;

    /// Releases what `init` acquired; another `init` may follow.
    fn cleanup(&mut self) -> Outcome<()> {
        Ok(())
    }

    /// Answers a text with a text; may come at any time.
    fn message(&mut self, _text: &str) -> Outcome<String> {
        Ok(String::new())
    }

    /// Draws all random choices from this number from now on (0 to 2^63 - 1); comes before `init`.
    fn seed(&mut self, _seed: u64) -> Outcome<()> {
        Err("this environment cannot be seeded".into())
    }

    /// Returns everything that later episodes depend on.
    fn save(&mut self) -> Outcome<Vec<u8>> {
        Err("this environment cannot be saved".into())
    }

    /// Goes on from what `save` returned, after `init`; check it, it may come from someone else.
    fn load(&mut self, _data: &[u8]) -> Outcome<()> {
        Err("this environment cannot be loaded".into())
    }
}
