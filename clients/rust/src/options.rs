use std::env;

/// The hub and the session that a program joins, and its name.
///
/// ```
/// let options = glue_rl::Options::named("walker").session("walk");
/// ```
pub struct Options {
    pub(crate) hub: String,
    pub(crate) session: String,
    pub(crate) name: String,
    pub(crate) log: Box<dyn Fn(&str)>,
}

impl Options {
    /// Returns the defaults: hub and session of the environment variables `GLUE_HUB` and `GLUE_SESSION`, else
    /// `tcp://127.0.0.1:4097` and `default`; lines for people go to standard error.
    pub fn named(name: &str) -> Options {
        Options {
            hub: env::var("GLUE_HUB").unwrap_or_else(|_| "tcp://127.0.0.1:4097".to_owned()),
            session: env::var("GLUE_SESSION").unwrap_or_else(|_| "default".to_owned()),
            name: name.to_owned(),
            log: Box::new(|line| eprintln!("{line}")),
        }
    }

    /// Sets the hub's address, such as `tcp://127.0.0.1:4097` or `ipc:///tmp/hub`.
    #[must_use]
    pub fn hub(mut self, address: &str) -> Options {
        self.hub = address.to_owned();
        self
    }

    /// Sets the session's name: 1 to 255 printable characters.
    #[must_use]
    pub fn session(mut self, name: &str) -> Options {
        self.session = name.to_owned();
        self
    }

    /// Sets what receives lines for people.
    #[must_use]
    pub fn log(mut self, log: impl Fn(&str) + 'static) -> Options {
        self.log = Box::new(log);
        self
    }
}
