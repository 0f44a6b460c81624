//! An experiment of a few episodes, for whatever agent and environment are there.
//!
//! With a hub (`glue-hub`), an agent and an environment: `cargo run --release --example experiment [episodes] [seed]`

use glue_rl::{Error, Experiment, Options};

const MAX_STEPS: u64 = 1000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let episodes: u64 = arguments.next().map_or(Ok(10), |text| text.parse())?;
    let seed: u64 = arguments.next().map_or(Ok(1), |text| text.parse())?;

    let options = Options::named("a few episodes");
    let mut glue = Experiment::connect(&options)?;
    glue.init(Some(seed))?;
    let mut done = 0;
    while done < episodes {
        match glue.episode(MAX_STEPS) {
            Ok(_) => {
                done += 1;
                println!("episode {done}: return {}, {} steps", glue.episode_return()?, glue.num_steps()?);
            }
            Err(Error::PeerLost(text)) => eprintln!("again, because {text}"),
            Err(error) => return Err(error.into()),
        }
    }
    glue.cleanup()?;
    glue.close("all done");
    Ok(())
}
