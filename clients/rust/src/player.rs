//! Agents and environments: what the hub can ask them, and how each call is answered exactly once.

use std::borrow::Cow;
use std::panic::{catch_unwind, resume_unwind, AssertUnwindSafe};

use crate::link::Link;
use crate::masks;
use crate::message::{encode, kind, Frames, Message, Scalar, CUT_OFF};
use crate::{AbstractType, Agent, Capability, Environment, Error, Options, Outcome};

/// Lets an agent take part in a session until the hub says goodbye; returns its reason.
///
/// # Errors
///
/// [`Error::Config`], [`Error::Refused`], [`Error::Protocol`], or [`Error::Player`] if a method of the agent failed. If one
/// panics, the hub is informed, and the panic goes on.
pub fn serve_agent(agent: &mut dyn Agent, options: &Options) -> Result<String, Error> {
    let capabilities = agent.capabilities().to_vec();
    let mut seen = AbstractType::default();
    serve("agent", &capabilities, options, &mut |message, body, answer| {
        match message.kind {
            kind::AGENT_INIT => agent.init(&text(body))?,
            kind::AGENT_START => {
                seen.read(body)?;
                agent.start(&seen)?.write(answer.body());
            }
            kind::AGENT_STEP => {
                seen.read(body)?;
                if message.scalars.len() > 1 {
                    agent.pace(message.float(1), message.float(2))?;
                }
                agent.step(message.float(0), &seen)?.write(answer.body());
            }
            kind::AGENT_END => agent.end(message.float(0))?,
            kind::AGENT_CLEANUP => agent.cleanup()?,
            kind::AGENT_MESSAGE => *answer.body() = agent.message(&text(body))?.into_bytes(),
            kind::AGENT_SEED => agent.seed(message.int(0))?,
            kind::AGENT_SAVE => *answer.body() = agent.save()?,
            kind::AGENT_LOAD => agent.load(body)?,
            kind::AGENT_METRICS => {
                let (names, doubles): (Vec<_>, Vec<_>) = agent.metrics()?.into_iter().unzip();
                let chars = names.join("\n").into_bytes();
                AbstractType { doubles, chars, ..AbstractType::default() }.write(answer.body());
            }
            _ => return Ok(false),
        }
        Ok(true)
    })
}

/// Lets an environment take part in a session, as [`serve_agent`] does an agent.
///
/// # Errors
///
/// As [`serve_agent`].
pub fn serve_environment(environment: &mut dyn Environment, options: &Options) -> Result<String, Error> {
    let capabilities = environment.capabilities().to_vec();
    let mut done = AbstractType::default();
    let mut sizes = Vec::new();
    serve("environment", &capabilities, options, &mut |message, body, answer| {
        match message.kind {
            kind::ENV_INIT => {
                let task_spec = environment.init()?;
                sizes = masks::sizes(&task_spec);
                *answer.body() = task_spec.into_bytes();
            }
            kind::ENV_START => {
                let first = environment.start()?;
                masks::check("start", &first.mask, &sizes)?;
                first.write_observation(answer.body())?;
            }
            kind::ENV_STEP => {
                done.read(body)?;
                let step = environment.step(&done)?;
                masks::check("step", &step.observation.mask, &sizes)?;
                let end = if step.truncated { Scalar::Int(CUT_OFF) } else { Scalar::Bool(step.terminal) };
                answer.scalars = vec![Scalar::Float(step.reward), end];
                step.observation.write_observation(answer.body())?;
            }
            kind::ENV_CLEANUP => environment.cleanup()?,
            kind::ENV_MESSAGE => *answer.body() = environment.message(&text(body))?.into_bytes(),
            kind::ENV_SEED => environment.seed(message.int(0))?,
            kind::ENV_SAVE => *answer.body() = environment.save()?,
            kind::ENV_LOAD => environment.load(body)?,
            _ => return Ok(false),
        }
        Ok(true)
    })
}

/// What a call brings.
#[derive(Default)]
struct Answer {
    scalars: Vec<Scalar>,
    body: Option<Vec<u8>>,
}

impl Answer {
    fn body(&mut self) -> &mut Vec<u8> {
        self.body.get_or_insert_with(Vec::new)
    }
}

/// Carries a call out; returns false if it is not one of this player's.
type Call<'a> = dyn FnMut(&Message, &[u8], &mut Answer) -> Outcome<bool> + 'a;

struct Player<'a> {
    link: Link<'a>,
    call: &'a mut Call<'a>,
    last_seq: u64,
    last_call: Frames,
    last_answer: Frames,
}

fn serve<'a>(
    role: &'static str,
    capabilities: &[Capability],
    options: &'a Options,
    call: &'a mut Call<'a>,
) -> Result<String, Error> {
    let mut capabilities: Vec<_> = capabilities
        .iter()
        .map(|capability| match capability {
            Capability::Seed => "seed",
            Capability::Save => "save",
            Capability::Metrics => "metrics",
            Capability::Pace => "pace",
        })
        .collect();
    capabilities.push("mask");
    if role == "environment" {
        capabilities.extend(["extras", "truncate"]);
    }
    let link = Link::new(role, options, &capabilities)?;
    let mut player = Player { link, call, last_seq: 0, last_call: Frames::default(), last_answer: Frames::default() };
    let error = player.answer_all();
    player.link.close(&error.to_string());
    match error {
        Error::HubClosed(reason) => Ok(reason),
        error => Err(error),
    }
}

impl Player<'_> {
    /// Answers calls until something ends it, and returns that.
    fn answer_all(&mut self) -> Error {
        let mut frames = Frames::default();
        loop {
            let done = match self.link.receive(&mut frames) {
                Ok(Some(message)) => self.take(&message, &mut frames),
                Ok(None) => Ok(()),
                Err(error) => Err(error),
            };
            if let Err(error) = done {
                return error;
            }
        }
    }

    fn take(&mut self, message: &Message, frames: &mut Frames) -> Result<(), Error> {
        match message.kind {
            // The last call is kept: if it comes again, it is the same hub, which never had the answer.
            kind::WELCOME if !message.bool(1) => self.last_seq = 0,
            kind::WELCOME | kind::NOTICE => (),
            kind::ERROR => self.link.log(&format!("the hub says: {}", message.text(1))),
            _ if self.link.is_welcomed() && message.seq >= self.last_seq => {
                if message.seq > self.last_seq && *frames != self.last_call {
                    self.carry_out(message, frames)?;
                    std::mem::swap(&mut self.last_call, frames);
                }
                self.last_seq = message.seq;
                self.link.send(&self.last_answer.header, self.last_answer.body.as_deref());
            }
            _ => (),
        }
        Ok(())
    }

    fn carry_out(&mut self, message: &Message, frames: &Frames) -> Result<(), Error> {
        let mut answer = Answer::default();
        let received = frames.body.as_deref().unwrap_or_default();
        let call = &mut self.call;
        let known = match catch_unwind(AssertUnwindSafe(|| call(message, received, &mut answer))) {
            Ok(Ok(known)) => known,
            Ok(Err(failure)) => return Err(self.report(message.seq, failure)),
            Err(panic) => {
                let text = panic_text(panic.as_ref());
                self.report(message.seq, text.as_str().into());
                self.link.close(&text);
                resume_unwind(panic);
            }
        };
        if !known {
            let text = format!("this player does not know kind {}", message.kind);
            let header = self.link.error(message.seq, "unknown-kind", &text);
            self.last_answer = Frames { header, body: None };
            return Ok(());
        }
        if let (kind::ENV_START | kind::ENV_STEP, Some(body)) = (message.kind, &mut answer.body) {
            self.link.cut(body, true);
        }
        if let Err(error) = self.link.check(answer.body.as_deref()) {
            return Err(self.report(message.seq, error.into()));
        }
        let header = encode(message.kind, self.link.session(), message.seq, &answer.scalars);
        self.last_answer = Frames { header, body: answer.body };
        Ok(())
    }

    /// Informs the hub that the player failed in a call.
    fn report(&mut self, seq: u64, failure: Box<dyn std::error::Error + Send + Sync>) -> Error {
        let header = self.link.error(seq, "exception", &failure.to_string());
        self.link.send(&header, None);
        Error::Player(failure)
    }
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "it panicked".to_owned())
}

/// A text as far as it is UTF-8.
fn text(body: &[u8]) -> Cow<'_, str> {
    String::from_utf8_lossy(body)
}
