//! The mirror, with which `glue-conform` judges this library: docs/clients.md says what it does.
//!
//! `glue-conform agent -- target/release/examples/mirror agent` (or environment, experiment)

use std::cell::RefCell;

use glue_rl::{
    serve_agent, serve_environment, AbstractType, Action, Agent, Capability, Environment, Error, Experiment, Extra,
    Extras, Observation, Options, Outcome, Step,
};

#[derive(Default)]
struct Mirror {
    count: i32,
    seed: u64,
    /// What the agent was told before this step.
    told: Vec<f64>,
}

impl Mirror {
    fn message(&self, text: &str) -> Outcome<String> {
        if text == "fail" {
            return Err("asked to fail".into());
        }
        Ok(text.to_owned())
    }

    fn save(&self) -> Outcome<Vec<u8>> {
        Ok(format!("{} {}", self.count, self.seed).into_bytes())
    }

    fn load(&mut self, data: &[u8]) -> Outcome<()> {
        let (count, seed) = std::str::from_utf8(data)?.split_once(' ').ok_or("two numbers are saved")?;
        self.count = count.parse()?;
        self.seed = seed.parse()?;
        Ok(())
    }

    fn mirror(&self, shown: &AbstractType, more: &[f64]) -> AbstractType {
        if *shown == AbstractType::default() {
            return AbstractType::default();
        }
        let doubles = shown.doubles.iter().rev().copied();
        AbstractType {
            ints: shown.ints.iter().rev().copied().chain([self.count]).collect(),
            doubles: doubles.chain([sum(&shown.ints)]).chain(more.iter().copied()).collect(),
            chars: shown.chars.iter().rev().copied().collect(),
            ..AbstractType::default()
        }
    }
}

/// Returns an observation, with what is beside it behind its runs.
fn shown(seen: &Observation) -> AbstractType {
    let mut all = AbstractType { mask: vec![], extras: Extras::new(), ..seen.clone() };
    let legal = seen.mask.iter().zip(0..).filter(|(legal, _)| **legal);
    all.ints.extend(legal.map(|(_, value)| value));
    for (name, extra) in &seen.extras {
        all.chars.extend(format!("\n{name}=").into_bytes());
        match extra {
            Extra::Int(value) => all.chars.extend(value.to_string().into_bytes()),
            Extra::Float(value) => all.doubles.push(*value),
            Extra::Text(value) => all.chars.extend(value.as_bytes()),
            Extra::Binary(value) => all.chars.extend(value),
            Extra::Ints(values) => {
                let decimals: Vec<_> = values.iter().map(i64::to_string).collect();
                all.chars.extend(decimals.join(" ").into_bytes());
            }
            Extra::Floats(values) => all.doubles.extend(values),
        }
    }
    all
}

fn sum(ints: &[i32]) -> f64 {
    ints.iter().map(|value| i64::from(*value)).sum::<i64>() as f64
}

impl Agent for Mirror {
    fn capabilities(&self) -> &[Capability] {
        &[Capability::Seed, Capability::Save, Capability::Metrics, Capability::Pace]
    }

    fn pace(&mut self, deadline: f64, latency: f64) -> Outcome<()> {
        self.told = vec![deadline, latency];
        Ok(())
    }

    fn metrics(&self) -> Outcome<Vec<(String, f64)>> {
        let count = f64::from(self.count);
        Ok(vec![("count".to_owned(), count), ("half the count".to_owned(), count / 2.0)])
    }

    fn init(&mut self, _: &str) -> Outcome<()> {
        self.count = 0;
        Ok(())
    }

    fn start(&mut self, observation: &Observation) -> Outcome<Action> {
        Agent::step(self, 0.0, observation)
    }

    fn step(&mut self, reward: f64, observation: &Observation) -> Outcome<Action> {
        self.count += 1;
        let told = std::mem::take(&mut self.told);
        Ok(self.mirror(&shown(observation), &[&[reward], &told[..]].concat()))
    }

    fn end(&mut self, _: f64) -> Outcome<()> {
        self.count += 1;
        Ok(())
    }

    fn message(&mut self, text: &str) -> Outcome<String> {
        Mirror::message(self, text)
    }

    fn seed(&mut self, seed: u64) -> Outcome<()> {
        self.seed = seed;
        Ok(())
    }

    fn save(&mut self) -> Outcome<Vec<u8>> {
        Mirror::save(self)
    }

    fn load(&mut self, data: &[u8]) -> Outcome<()> {
        Mirror::load(self, data)
    }
}

impl Environment for Mirror {
    fn capabilities(&self) -> &[Capability] {
        &[Capability::Seed, Capability::Save]
    }

    fn init(&mut self) -> Outcome<String> {
        self.count = 0;
        Ok("a mirror, größer than it is".to_owned())
    }

    fn start(&mut self) -> Outcome<Observation> {
        self.count += 1;
        Ok([self.count].into())
    }

    fn step(&mut self, action: &Action) -> Outcome<Step> {
        self.count += 1;
        let mut observation = self.mirror(action, &[]);
        if action.chars.last() == Some(&b'&') {
            observation.mask = action.ints.iter().map(|value| *value != 0).collect();
            let extras = [
                ("count", i64::from(self.count).into()),
                ("half", (f64::from(self.count) + 0.5).into()),
                ("text", "größer".into()),
                ("chars", Extra::Binary(action.chars.clone())),
                ("ints", Extra::Ints(action.ints.iter().copied().map(i64::from).collect())),
                ("doubles", Extra::Floats(action.doubles.clone())),
            ];
            observation.extras = extras.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        }
        Ok(Step {
            reward: action.doubles.first().copied().unwrap_or(0.0),
            terminal: action.chars.last() == Some(&b'!'),
            observation,
            truncated: action.chars.last() == Some(&b'?'),
        })
    }

    fn message(&mut self, text: &str) -> Outcome<String> {
        Mirror::message(self, text)
    }

    fn seed(&mut self, seed: u64) -> Outcome<()> {
        self.seed = seed;
        Ok(())
    }

    fn save(&mut self) -> Outcome<Vec<u8>> {
        Mirror::save(self)
    }

    fn load(&mut self, data: &[u8]) -> Outcome<()> {
        Mirror::load(self, data)
    }
}

/// What the experiment shows of a verb's values.
fn result(ints: Vec<i32>, mut doubles: Vec<f64>, chars: Vec<u8>) -> Action {
    doubles.push(sum(&ints));
    Action { ints, doubles, chars, ..Action::default() }
}

/// The terminal as a number; 2 for a cut-off.
fn flag(terminal: bool, truncated: bool) -> i32 {
    if truncated {
        2
    } else {
        terminal.into()
    }
}

fn words(text: &str) -> Action {
    result(vec![], vec![], text.into())
}

fn both(observation: &Observation, action: &Action, ints: &[i32], doubles: &[f64]) -> Action {
    let seen = shown(observation);
    result(
        [&seen.ints, &action.ints, ints].concat(),
        [&seen.doubles, &action.doubles, doubles].concat(),
        [&seen.chars[..], &action.chars].concat(),
    )
}

fn carry_out(
    glue: &mut Experiment<'_>,
    verb: &str,
    argument: &[u8],
    order: &Step,
    notices: &RefCell<Vec<String>>,
) -> Result<Action, Error> {
    let text = String::from_utf8_lossy(argument);
    let given = Observation { chars: argument.to_vec(), extras: Extras::new(), ..order.observation.clone() };
    let nothing = AbstractType::default();
    let number = || text.parse().expect("a number");
    Ok(match verb {
        "RL_INIT" => words(&glue.init(if text.is_empty() { None } else { Some(number()) })?),
        "RL_START" => {
            let start = glue.start()?;
            both(&start.observation, &start.action, &[], &[])
        }
        "RL_STEP" => {
            let step = glue.step()?;
            both(&step.observation, &step.action, &[flag(step.terminal, step.truncated)], &[step.reward])
        }
        "RL_EPISODE" => result(vec![glue.episode(number())?.into()], vec![], vec![]),
        "RL_RETURN" => result(vec![], vec![glue.episode_return()?], vec![]),
        "RL_NUM_STEPS" => words(&glue.num_steps()?.to_string()),
        "RL_NUM_EPISODES" => words(&glue.num_episodes()?.to_string()),
        "RL_AGENT_MESSAGE" => words(&glue.agent_message(&text)?),
        "RL_ENV_MESSAGE" => words(&glue.env_message(&text)?),
        "RL_CLEANUP" => glue.cleanup().map(|()| words(""))?,
        "RL_ENV_START" => both(&glue.env_start()?, &nothing, &[], &[]),
        "RL_ENV_STEP" => {
            let step = glue.env_step(&given)?;
            both(&step.observation, &nothing, &[flag(step.terminal, step.truncated)], &[step.reward])
        }
        "RL_AGENT_START" => both(&nothing, &glue.agent_start(&given)?, &[], &[]),
        "RL_AGENT_STEP" => both(&nothing, &glue.agent_step(order.reward, &given)?, &[], &[]),
        "RL_AGENT_END" => glue.agent_end(order.reward).map(|()| words(""))?,
        "RL_AGENT_SAVE" => result(vec![], vec![], glue.agent_save()?),
        "RL_ENV_SAVE" => result(vec![], vec![], glue.env_save()?),
        "RL_AGENT_METRICS" => {
            let (names, values): (Vec<_>, Vec<_>) = glue.agent_metrics()?.into_iter().unzip();
            result(vec![], values, names.join("\n").into_bytes())
        }
        "RL_AGENT_LOAD" => glue.agent_load(argument).map(|()| words(""))?,
        "RL_ENV_LOAD" => glue.env_load(argument).map(|()| words(""))?,
        "notices" => words(&notices.take().join("\n")),
        _ => panic!("the mirror was ordered to do {verb}, which it does not know"),
    })
}

fn mirror_experiment(options: &Options) -> Result<(), Error> {
    let notices = RefCell::new(Vec::new());
    let keep = |event: &str, role: &str, name: &str| notices.borrow_mut().push(format!("{event} {role} {name}"));
    let mut glue = Experiment::connect_with_notices(options, keep)?;
    let mut shown = Action { chars: b"ready".to_vec(), ..Action::default() };
    loop {
        let order = glue.env_step(&shown)?;
        let chars = &order.observation.chars;
        let end = chars.iter().position(|char| *char == b' ').unwrap_or(chars.len());
        let verb = String::from_utf8_lossy(&chars[..end]);
        if verb == "end" {
            return Ok(());
        }
        let argument = chars.get(end + 1..).unwrap_or_default();
        shown = match carry_out(&mut glue, &verb, argument, &order, &notices) {
            Ok(shown) => shown,
            Err(error) => match error.code() {
                Some(code) => words(&format!("ERROR {code} {error}")),
                None => return Err(error),
            },
        };
    }
}

fn main() {
    let role = std::env::args().nth(1).unwrap_or_default();
    let options = Options::named("mirror");
    let done = match role.as_str() {
        "agent" => serve_agent(&mut Mirror::default(), &options),
        "environment" => serve_environment(&mut Mirror::default(), &options),
        _ => mirror_experiment(&options).map(|()| "the end".to_owned()),
    };
    match done {
        Ok(goodbye) | Err(Error::HubClosed(goodbye)) => println!("{goodbye}"),
        Err(error) => {
            println!("{error}");
            std::process::exit(1);
        }
    }
}
