//! A ZeroMQ DEALER over tcp or a Unix socket: one connection after another to the same address.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::thread;
use std::time::{Duration, Instant};

use crate::message::Frames;
use crate::zmtp::{greeting, put_frame, FrameReader, Item, COMMAND, MORE, READY};
use crate::Error;

const RECONNECT: Duration = Duration::from_millis(100);
const CONNECT: Duration = Duration::from_secs(5);
/// How long the last messages may take to leave.
const LINGER: Duration = Duration::from_secs(1);
const SMALL: usize = 1 << 16;
const MAX_PATH: usize = 107;

enum Address {
    Tcp(Vec<SocketAddr>),
    Unix(PathBuf),
}

enum Stream {
    Tcp(TcpStream),
    Unix(UnixStream),
}

/// What `receive` found.
#[derive(PartialEq)]
pub(crate) enum Received {
    Message,
    /// Nothing in the time given, or a connection was made or lost.
    Nothing,
}

pub(crate) struct Dealer {
    address: Address,
    stream: Option<Stream>,
    reader: FrameReader,
    output: Vec<u8>,
    ready: bool,
    connections: u64,
    attempted: Option<Instant>,
    /// How long was waited since anything was received.
    silent: Duration,
    waits: Option<Duration>,
    farewell: Option<String>,
}

impl Dealer {
    pub(crate) fn new(hub: &str) -> Result<Self, Error> {
        Ok(Dealer {
            address: Address::parse(hub)?,
            stream: None,
            reader: FrameReader::new(),
            output: Vec::new(),
            ready: false,
            connections: 0,
            attempted: None,
            silent: Duration::ZERO,
            waits: None,
            farewell: None,
        })
    }

    /// Returns how many connections there were, this one included.
    pub(crate) fn connections(&self) -> u64 {
        self.connections
    }

    /// Returns whether there is a connection that can carry messages.
    pub(crate) fn is_ready(&self) -> bool {
        self.ready
    }

    /// Returns, once, the reason with which a hub ended a connection.
    pub(crate) fn farewell(&mut self) -> Option<String> {
        self.farewell.take()
    }

    /// Waits for the next message for at most `time`; gives a connection up that was silent for `timeout`.
    pub(crate) fn receive(
        &mut self,
        frames: &mut Frames,
        time: Duration,
        timeout: Duration,
    ) -> Result<Received, Error> {
        if self.stream.is_none() && !self.connect() {
            return Ok(Received::Nothing);
        }
        loop {
            while let Some(item) = self.reader.next(frames)? {
                if item == Item::Message {
                    return Ok(Received::Message);
                }
                if self.take(&item) {
                    return Ok(Received::Nothing);
                }
            }
            match self.read(time) {
                Ok(0) => self.stream = None,
                Ok(count) => {
                    self.silent = Duration::ZERO;
                    self.reader.received(count);
                    continue;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    self.silent += time;
                    if self.silent >= timeout {
                        self.stream = None;
                    }
                }
                Err(_) => self.stream = None,
            }
            self.ready &= self.stream.is_some();
            return Ok(Received::Nothing);
        }
    }

    /// Sends a message. Without a connection it is lost, as when one breaks: the hub asks again.
    pub(crate) fn send(&mut self, header: &[u8], body: Option<&[u8]>) {
        if !self.ready {
            return;
        }
        self.output.clear();
        self.output.shrink_to(SMALL);
        put_frame(&mut self.output, if body.is_some() { MORE } else { 0 }, header);
        if let Some(body) = body {
            put_frame(&mut self.output, 0, body);
        }
        self.write();
    }

    /// Closes when what was sent has left.
    pub(crate) fn close(&mut self) {
        if let (true, Some(stream)) = (self.ready, &mut self.stream) {
            let deadline = Instant::now() + LINGER;
            let mut rest = [0; 4096];
            let _ = stream.shutdown();
            while let Some(left) = deadline.checked_duration_since(Instant::now()).filter(|left| !left.is_zero()) {
                if stream.wait_at_most(left).is_err() || !matches!(stream.read(&mut rest), Ok(1..)) {
                    break;
                }
            }
        }
        self.ready = false;
        self.stream = None;
    }

    fn connect(&mut self) -> bool {
        if let Some(attempted) = self.attempted {
            thread::sleep(RECONNECT.saturating_sub(attempted.elapsed()));
        }
        self.attempted = Some(Instant::now());
        self.stream = self.address.connect().ok();
        self.reader = FrameReader::new();
        self.silent = Duration::ZERO;
        self.waits = None;
        self.output = greeting().to_vec();
        self.write();
        self.stream.is_some()
    }

    fn read(&mut self, time: Duration) -> io::Result<usize> {
        let stream = match &mut self.stream {
            Some(stream) => stream,
            None => return Ok(0),
        };
        if self.waits != Some(time) {
            stream.wait_at_most(time)?;
            self.waits = Some(time);
        }
        stream.read(self.reader.room())
    }

    fn write(&mut self) {
        if let Some(stream) = &mut self.stream {
            if stream.write_all(&self.output).is_err() {
                self.stream = None;
                self.ready = false;
            }
        }
    }

    /// Handles anything that is not a message; returns whether a connection was made or lost.
    fn take(&mut self, item: &Item) -> bool {
        match item {
            Item::Greeting => {
                self.output.clear();
                put_frame(&mut self.output, COMMAND, READY);
                self.write();
            }
            Item::Command(name, data) => match name.as_slice() {
                b"READY" => {
                    self.ready = true;
                    self.connections += 1;
                    return true;
                }
                b"PING" => {
                    // After two bytes of time to live comes a context that the PONG repeats.
                    let pong = [b"\x04PONG", data.get(2..).unwrap_or_default()].concat();
                    self.output.clear();
                    put_frame(&mut self.output, COMMAND, &pong);
                    self.write();
                }
                b"ERROR" => {
                    let reason = data.get(1..).unwrap_or_default();
                    self.farewell = Some(String::from_utf8_lossy(reason).into_owned());
                    self.stream = None;
                    self.ready = false;
                }
                _ => (),
            },
            Item::Message => (),
        }
        self.stream.is_none()
    }
}

impl Address {
    fn parse(hub: &str) -> Result<Self, Error> {
        if let Some(path) = hub.strip_prefix("ipc://").filter(|path| !path.is_empty()) {
            let size = path.len();
            if size > MAX_PATH {
                let text = format!("the path of a Unix socket has at most {MAX_PATH} bytes, and {path} has {size}");
                return Err(Error::Config(text));
            }
            return Ok(Address::Unix(path.into()));
        }
        let malformed = || {
            Error::Config(format!("the address of a hub is like tcp://127.0.0.1:4097 or ipc:///tmp/hub, not \"{hub}\""))
        };
        let (host, port) = hub.strip_prefix("tcp://").and_then(|rest| rest.rsplit_once(':')).ok_or_else(malformed)?;
        let port: u16 = port.parse().ok().filter(|port| *port > 0).ok_or_else(malformed)?;
        let host = host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(host);
        if host.is_empty() {
            return Err(malformed());
        }
        match (host, port).to_socket_addrs() {
            Ok(addresses) => Ok(Address::Tcp(addresses.collect())),
            Err(_) => Err(Error::Config(format!("the host {host} is unknown"))),
        }
    }

    fn connect(&self) -> io::Result<Stream> {
        match self {
            Address::Tcp(addresses) => {
                let mut result = Err(ErrorKind::AddrNotAvailable.into());
                for address in addresses {
                    result = TcpStream::connect_timeout(address, CONNECT);
                    if result.is_ok() {
                        break;
                    }
                }
                let stream = result?;
                stream.set_nodelay(true)?;
                stream.set_write_timeout(Some(CONNECT))?;
                Ok(Stream::Tcp(stream))
            }
            Address::Unix(path) => {
                let stream = UnixStream::connect(path)?;
                stream.set_write_timeout(Some(CONNECT))?;
                Ok(Stream::Unix(stream))
            }
        }
    }
}

impl Stream {
    fn wait_at_most(&self, time: Duration) -> io::Result<()> {
        match self {
            Stream::Tcp(stream) => stream.set_read_timeout(Some(time)),
            Stream::Unix(stream) => stream.set_read_timeout(Some(time)),
        }
    }

    fn shutdown(&self) -> io::Result<()> {
        match self {
            Stream::Tcp(stream) => stream.shutdown(Shutdown::Write),
            Stream::Unix(stream) => stream.shutdown(Shutdown::Write),
        }
    }

    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        match self {
            Stream::Tcp(stream) => stream.read(to),
            Stream::Unix(stream) => stream.read(to),
        }
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self {
            Stream::Tcp(stream) => stream.write_all(bytes),
            Stream::Unix(stream) => stream.write_all(bytes),
        }
    }
}
