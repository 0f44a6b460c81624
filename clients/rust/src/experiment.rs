//! An experiment: it keeps the request that is not answered, and repeats it over each new connection.

use crate::link::Link;
use crate::message::{encode, kind, Frames, Message, Scalar};
use crate::{AbstractType, Action, Error, Observation, Options, Step};

/// What RL_start returns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Start {
    /// The first observation.
    pub observation: Observation,
    /// The first action.
    pub action: Action,
}

/// What RL_step returns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Transition {
    /// The reward.
    pub reward: f64,
    /// Whether the episode is over.
    pub terminal: bool,
    /// The observation after the step.
    pub observation: Observation,
    /// The next action; after a terminal step the one that was executed.
    pub action: Action,
    /// Whether the environment cut the episode off, in a state that is not terminal.
    pub truncated: bool,
}

/// Takes an event, a role and a name.
type OnNotice<'a> = Box<dyn FnMut(&str, &str, &str) + 'a>;

/// RL-Glue's verbs over a hub. Each waits for the players.
///
/// # Errors
///
/// Every verb may fail with [`Error::PeerLost`], [`Error::PeerFailed`], [`Error::Unsupported`] or
/// [`Error::HubClosed`].
pub struct Experiment<'a> {
    link: Link<'a>,
    on_notice: OnNotice<'a>,
    frames: Frames,
    seq: u64,
    /// Whether the hub has answered since it last said that it did not know us.
    answered: bool,
}

impl<'a> Experiment<'a> {
    /// Joins a session as its experiment, once a hub is there.
    ///
    /// # Errors
    ///
    /// [`Error::Config`], [`Error::Refused`], [`Error::HubClosed`] or [`Error::Protocol`].
    pub fn connect(options: &'a Options) -> Result<Self, Error> {
        Self::connect_with_notices(options, |_, _, _| ())
    }

    /// Joins a session; `on_notice` receives the event (a player `joined`, was `lost`, has `returned` or is `slow`), the
    /// role and the name.
    ///
    /// # Errors
    ///
    /// As [`connect`](Self::connect).
    pub fn connect_with_notices(
        options: &'a Options,
        on_notice: impl FnMut(&str, &str, &str) + 'a,
    ) -> Result<Self, Error> {
        let link = Link::new("experiment", options, &["mask", "extras"])?;
        let on_notice = Box::new(on_notice);
        let mut experiment = Experiment { link, on_notice, frames: Frames::default(), seq: 0, answered: false };
        while !experiment.link.is_welcomed() {
            experiment.receive()?;
        }
        Ok(experiment)
    }

    /// RL_init; returns the task spec. From a seed (0 to 2^63 - 1) both players are seeded.
    pub fn init(&mut self, seed: Option<u64>) -> Result<String, Error> {
        let seed = seed.map_or(Scalar::Nil, Scalar::Int);
        self.ask(kind::RL_INIT, &[seed], None)?;
        Ok(self.text())
    }

    /// RL_start.
    pub fn start(&mut self) -> Result<Start, Error> {
        self.ask(kind::RL_START, &[], None)?;
        let (observation, action) = self.both()?;
        Ok(Start { observation, action })
    }

    /// RL_step.
    pub fn step(&mut self) -> Result<Transition, Error> {
        let reply = self.ask(kind::RL_STEP, &[], None)?;
        let (observation, action) = self.both()?;
        let (terminal, truncated) = (reply.bool(1), reply.is_cut_off(1));
        Ok(Transition { reward: reply.float(0), terminal, observation, action, truncated })
    }

    /// RL_episode of at most `max_steps` steps, 0 for any number; returns whether it reached its end, and was not cut off.
    pub fn episode(&mut self, max_steps: u64) -> Result<bool, Error> {
        let reply = self.ask(kind::RL_EPISODE, &[Scalar::Int(max_steps)], None)?;
        Ok(reply.bool(0) && !reply.is_cut_off(0))
    }

    /// RL_return: the sum of the episode's rewards.
    pub fn episode_return(&mut self) -> Result<f64, Error> {
        Ok(self.ask(kind::RL_RETURN, &[], None)?.float(0))
    }

    /// RL_num_steps: the number of the episode's steps.
    pub fn num_steps(&mut self) -> Result<u64, Error> {
        Ok(self.ask(kind::RL_NUM_STEPS, &[], None)?.int(0))
    }

    /// RL_num_episodes: the number of episodes that reached their end since the init.
    pub fn num_episodes(&mut self) -> Result<u64, Error> {
        Ok(self.ask(kind::RL_NUM_EPISODES, &[], None)?.int(0))
    }

    /// RL_agent_message: a text for the agent, and its answer.
    pub fn agent_message(&mut self, text: &str) -> Result<String, Error> {
        self.ask(kind::RL_AGENT_MESSAGE, &[], Some(text.as_bytes()))?;
        Ok(self.text())
    }

    /// RL_env_message: a text for the environment, and its answer.
    pub fn env_message(&mut self, text: &str) -> Result<String, Error> {
        self.ask(kind::RL_ENV_MESSAGE, &[], Some(text.as_bytes()))?;
        Ok(self.text())
    }

    /// RL_cleanup.
    pub fn cleanup(&mut self) -> Result<(), Error> {
        self.ask(kind::RL_CLEANUP, &[], None).map(drop)
    }

    /// RL_env_start, for an experiment that stands between the players.
    pub fn env_start(&mut self) -> Result<Observation, Error> {
        self.ask(kind::RL_ENV_START, &[], None)?;
        self.one()
    }

    /// RL_env_step: executes an action.
    pub fn env_step(&mut self, action: &Action) -> Result<Step, Error> {
        let mut body = Vec::new();
        action.write(&mut body);
        let reply = self.ask(kind::RL_ENV_STEP, &[], Some(&body))?;
        let (terminal, truncated) = (reply.bool(1), reply.is_cut_off(1));
        Ok(Step { reward: reply.float(0), terminal, observation: self.one()?, truncated })
    }

    /// RL_agent_start: the first observation of an episode for the agent, and its action.
    pub fn agent_start(&mut self, observation: &Observation) -> Result<Action, Error> {
        self.ask(kind::RL_AGENT_START, &[], Some(&self.shown(observation)?))?;
        self.one()
    }

    /// RL_agent_step: a reward and an observation for the agent, and its action.
    pub fn agent_step(&mut self, reward: f64, observation: &Observation) -> Result<Action, Error> {
        self.ask(kind::RL_AGENT_STEP, &[Scalar::Float(reward)], Some(&self.shown(observation)?))?;
        self.one()
    }

    /// RL_agent_end: the last reward for the agent.
    pub fn agent_end(&mut self, reward: f64) -> Result<(), Error> {
        self.ask(kind::RL_AGENT_END, &[Scalar::Float(reward)], None).map(drop)
    }

    /// Saves the agent.
    pub fn agent_save(&mut self) -> Result<Vec<u8>, Error> {
        self.ask(kind::RL_AGENT_SAVE, &[], None)?;
        Ok(self.body().to_vec())
    }

    /// Loads the agent from what [`agent_save`](Self::agent_save) returned.
    pub fn agent_load(&mut self, data: &[u8]) -> Result<(), Error> {
        self.ask(kind::RL_AGENT_LOAD, &[], Some(data)).map(drop)
    }

    /// Returns the agent's own numbers with their names.
    pub fn agent_metrics(&mut self) -> Result<Vec<(String, f64)>, Error> {
        self.ask(kind::RL_AGENT_METRICS, &[], None)?;
        let packed = self.one()?;
        let names = String::from_utf8_lossy(&packed.chars).into_owned();
        Ok(names.split('\n').map(str::to_owned).zip(packed.doubles).collect())
    }

    /// Saves the environment.
    pub fn env_save(&mut self) -> Result<Vec<u8>, Error> {
        self.ask(kind::RL_ENV_SAVE, &[], None)?;
        Ok(self.body().to_vec())
    }

    /// Loads the environment from what [`env_save`](Self::env_save) returned.
    pub fn env_load(&mut self, data: &[u8]) -> Result<(), Error> {
        self.ask(kind::RL_ENV_LOAD, &[], Some(data)).map(drop)
    }

    /// Says goodbye to the hub with a reason, and leaves. Dropping an experiment does so, too.
    pub fn close(mut self, reason: &str) {
        self.link.close(reason);
    }

    /// Returns the reply to a request, however often the network fails; its body is in `frames`.
    fn ask(&mut self, kind: u64, scalars: &[Scalar], body: Option<&[u8]>) -> Result<Message, Error> {
        self.link.check(body)?;
        let beyond = |scalar: &&Scalar| matches!(scalar, Scalar::Int(value) if *value > i64::MAX as u64);
        if let Some(Scalar::Int(value)) = scalars.iter().find(beyond) {
            return Err(Error::Config(format!("integers are from 0 to 2^63 - 1, not {value}")));
        }
        self.seq += 1;
        let header = encode(kind, self.link.session(), self.seq, scalars);
        if self.link.is_welcomed() {
            self.link.send(&header, body);
        }
        loop {
            let message = match self.receive()? {
                Some(message) => message,
                None => continue,
            };
            match message.kind {
                kind::WELCOME => self.link.send(&header, body),
                kind::ERROR if message.seq == self.seq => {
                    self.answered = true;
                    return Err(Error::of_request(message.text(0), message.text(1)));
                }
                kind::ERROR => self.link.log(&format!("the hub says: {}", message.text(1))),
                other if other == kind && message.seq == self.seq => {
                    self.answered = true;
                    return Ok(message);
                }
                _ => (),
            }
        }
    }

    /// Returns the next message, having acted on it if it is a WELCOME or a NOTICE.
    fn receive(&mut self) -> Result<Option<Message>, Error> {
        let message = match self.link.receive(&mut self.frames)? {
            Some(message) => message,
            None => return Ok(None),
        };
        match message.kind {
            kind::NOTICE => {
                (self.on_notice)(message.text(0), message.text(1), message.text(2));
                Ok(None)
            }
            kind::WELCOME if !message.bool(1) && self.answered => {
                self.answered = false;
                Err(Error::HubClosed(
                    "the hub knows nothing of this experiment: it was restarted, or had given it up".to_owned(),
                ))
            }
            _ => Ok(Some(message)),
        }
    }

    fn body(&self) -> &[u8] {
        self.frames.body.as_deref().unwrap_or_default()
    }

    fn text(&self) -> String {
        String::from_utf8_lossy(self.body()).into_owned()
    }

    fn one(&self) -> Result<AbstractType, Error> {
        let mut one = AbstractType::default();
        one.read(self.body())?;
        Ok(one)
    }

    fn both(&self) -> Result<(Observation, Action), Error> {
        let (mut observation, mut action) = (Observation::default(), Action::default());
        action.read(observation.read(self.body())?)?;
        Ok((observation, action))
    }

    /// Returns what the agent is to be shown of an observation, as it crosses the wire.
    fn shown(&self, observation: &Observation) -> Result<Vec<u8>, Error> {
        let mut body = Vec::new();
        observation.write_observation(&mut body)?;
        self.link.cut(&mut body, false);
        Ok(body)
    }
}

impl Drop for Experiment<'_> {
    fn drop(&mut self) {
        self.link.close("the experiment is over");
    }
}
