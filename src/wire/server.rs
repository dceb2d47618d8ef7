//! Connections: each has a thread that reads and one that writes, so that no client can delay another one or the
//! window.

use std::collections::HashMap;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::connection_file::ConnectionFile;
use super::lines::read_line;
use super::message::{PROTOCOL, Request, parse};
use crate::error::{Error, Result};
use crate::scene::rig::merge_patch::Object;

/// Connections at a time, those that have not said hello yet included.
const MOST_CONNECTIONS: usize = 128;
/// Time in which a connection must say hello.
const HELLO_TIME: Duration = Duration::from_secs(10);
/// Time in which a client may read its last answer.
const CLOSING_TIME: Duration = Duration::from_secs(1);
/// Bytes of a line before and after hello. A rig of 10,000 lights has fewer.
const MOST_HELLO: usize = 4096;
const MOST_LINE: usize = 16 << 20;
/// Requests of a client that are read before the first one of them is answered.
const MOST_REQUESTS: usize = 64;
/// With more bytes waiting, a reader that takes none of them for a while is disconnected, and with four times as many
/// any reader. It can connect again and gets the lights as they are.
const MOST_WAITING: usize = 64 << 20;
const READING_TIME: Duration = Duration::from_secs(2);
/// Bytes written at a time.
const CHUNK: usize = 64 << 10;
/// With more bytes waiting, messages that only inform are left out.
const MANY_WAITING: usize = 64 << 10;

/// A connected client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Client(u32);

/// What a connection tells the thread that owns the lights.
pub enum Inbound {
    /// The client has said hello.
    Joined(Client),
    /// What it asks for, or why that cannot be read.
    Request(Pending, Result<Request, String>),
    Left(Client),
}

/// A request that must be answered, by [`Server::answer`].
#[must_use]
pub struct Pending {
    pub client: Client,
    id: Option<u64>,
}

/// Listens for clients and sends them messages. Ends with all of its connections when it is dropped.
pub struct Server {
    shared: Arc<Shared>,
    /// Where it listens; `None` on standard input and output.
    port: Option<u16>,
    _file: Option<ConnectionFile>,
}

struct Shared {
    clients: Mutex<HashMap<Client, Connection>>,
    /// Connections, with those that have not said hello.
    count: AtomicUsize,
    ended: AtomicBool,
    token: String,
    on: Box<dyn Fn(Inbound) + Send + Sync>,
}

/// What is known of a client.
struct Connection {
    name: String,
    outbox: Sender<Vec<u8>>,
    /// Bytes in the outbox.
    waiting: Arc<AtomicUsize>,
    /// When the client last took some of them.
    last_read: Arc<Mutex<Instant>>,
    unanswered: Arc<Unanswered>,
    /// `None` on standard output.
    socket: Option<TcpStream>,
}

/// Number of requests without an answer.
struct Unanswered {
    /// `None` once nothing will be answered any more.
    count: Mutex<Option<usize>>,
    fewer: Condvar,
}

impl Server {
    /// Listens on the loopback address alone, on any free port, which `file` tells together with the token that clients
    /// must send. `on` is called on other threads.
    pub fn listen(file: &Path, on: impl Fn(Inbound) + Send + Sync + 'static) -> Result<Self> {
        let cannot = |error: io::Error| Error::invalid("the wire", format!("cannot listen on 127.0.0.1: {error}"));
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).map_err(cannot)?;
        let port = listener.local_addr().map_err(cannot)?.port();
        let mut token = [0; 16];
        getrandom::fill(&mut token).map_err(|error| Error::invalid("the wire", format!("no random token: {error}")))?;
        let token = format!("{:032x}", u128::from_le_bytes(token));
        let shared = Arc::new(Shared::new(token, on));
        let file = ConnectionFile::write(file, port, &shared.token)?;
        let accepting = shared.clone();
        std::thread::spawn(move || accepting.accept(&listener));
        Ok(Self { shared, port: Some(port), _file: Some(file) })
    }

    /// One client on standard input and output, which needs no hello. Its end is [`Inbound::Left`].
    pub fn on_standard_streams(on: impl Fn(Inbound) + Send + Sync + 'static) -> Self {
        let shared = Arc::new(Shared::new(String::new(), on));
        let reading = shared.clone();
        std::thread::spawn(move || {
            let client = Client(0);
            let unanswered = reading.join(client, String::new(), io::stdout(), None);
            let _ = reading.read(client, &mut io::stdin().lock(), &unanswered); // its end is all that matters
            reading.leave(client);
        });
        Self { shared, port: None, _file: None }
    }

    /// Answers a request: members of the answer, or the reason why it was refused.
    pub fn answer(&self, Pending { client, id }: Pending, answer: std::result::Result<Object, String>) {
        let mut message = Object::new();
        message.extend(id.map(|id| ("id".to_owned(), id.into())));
        match answer {
            Ok(members) => {
                message.insert("ok".into(), true.into());
                message.extend(members);
            }
            Err(reason) => _ = message.insert("error".into(), reason.into()),
        }
        let clients = self.shared.clients();
        if let Some(connection) = clients.get(&client) {
            connection.send(line(&message.into()));
            connection.unanswered.answered();
        }
    }

    /// Ends the connection of a client that has left.
    pub fn forget(&self, client: Client) {
        if let Some(connection) = self.shared.clients().remove(&client) {
            connection.unanswered.close();
        }
    }

    /// Sends an event to one client.
    pub fn send(&self, client: Client, event: &Value) {
        if let Some(connection) = self.shared.clients().get(&client) {
            connection.send(line(event));
        }
    }

    /// Sends an event to all clients for which `to` holds.
    pub fn broadcast(&self, event: &Value, to: impl Fn(Client) -> bool) {
        let line = line(event);
        let clients = self.shared.clients();
        clients.iter().filter(|(client, _)| to(**client)).for_each(|(_, connection)| connection.send(line.clone()));
    }

    /// Tells all clients that read fast enough.
    pub fn inform(&self, event: &Value) {
        let line = line(event);
        let clients = self.shared.clients();
        let fast = clients.values().filter(|connection| connection.waiting.load(Ordering::Relaxed) < MANY_WAITING);
        fast.for_each(|connection| connection.send(line.clone()));
    }

    /// The name of a client, if it is connected.
    pub fn name(&self, client: Client) -> Option<String> {
        self.shared.clients().get(&client).map(|connection| connection.name.clone())
    }

    pub fn has_clients(&self) -> bool {
        !self.shared.clients().is_empty()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Relaxed);
        if let Some(port) = self.port {
            drop(TcpStream::connect((Ipv4Addr::LOCALHOST, port))); // wakes the thread that accepts
        }
        // What waits is written first: answers of the last requests, too.
        let deadline = Instant::now() + Duration::from_secs(1);
        for (_, connection) in self.shared.clients().drain() {
            while connection.waiting.load(Ordering::Relaxed) > 0 && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(1));
            }
            connection.close();
        }
    }
}

fn line(message: &Value) -> Vec<u8> {
    let mut line = message.to_string().into_bytes();
    line.push(b'\n');
    line
}

impl Connection {
    fn send(&self, line: Vec<u8>) {
        let waiting = self.waiting.fetch_add(line.len(), Ordering::Relaxed);
        let last_read = *self.last_read.lock().expect("no thread panics while it holds this lock");
        let has_stopped = last_read.elapsed() > READING_TIME || waiting > 4 * MOST_WAITING;
        let is_slow = self.socket.is_some() && waiting > MOST_WAITING && has_stopped;
        if is_slow || self.outbox.send(line).is_err() {
            self.close();
        }
    }

    /// Its threads end.
    fn close(&self) {
        self.unanswered.close();
        if let Some(socket) = &self.socket {
            let _ = socket.shutdown(Shutdown::Both); // fails if it is closed already
        }
    }
}

impl Unanswered {
    /// Waits until there are fewer than allowed. Returns whether there will be answers.
    fn add(&self) -> bool {
        let count = self.count.lock().expect("no thread panics while it holds this lock");
        let are_many = |count: &mut Option<usize>| count.is_some_and(|count| count >= MOST_REQUESTS);
        let few = self.fewer.wait_while(count, are_many);
        let mut count = few.expect("no thread panics while it holds this lock");
        *count = count.map(|count| count + 1);
        count.is_some()
    }

    fn answered(&self) {
        let mut count = self.count.lock().expect("no thread panics while it holds this lock");
        *count = count.map(|count| count - 1);
        self.fewer.notify_one();
    }

    fn close(&self) {
        *self.count.lock().expect("no thread panics while it holds this lock") = None;
        self.fewer.notify_one();
    }
}

impl Shared {
    fn new(token: String, on: impl Fn(Inbound) + Send + Sync + 'static) -> Self {
        Self {
            clients: Mutex::default(),
            count: AtomicUsize::new(0),
            ended: AtomicBool::new(false),
            token,
            on: Box::new(on),
        }
    }

    fn clients(&self) -> MutexGuard<'_, HashMap<Client, Connection>> {
        self.clients.lock().expect("no thread panics while it holds this lock")
    }

    fn accept(self: Arc<Self>, listener: &TcpListener) {
        for (number, stream) in (0..).zip(listener.incoming()) {
            if self.ended.load(Ordering::Relaxed) {
                return;
            }
            let Ok(stream) = stream else {
                std::thread::sleep(Duration::from_millis(100)); // out of file handles: some may be closed soon
                continue;
            };
            let others = self.count.fetch_add(1, Ordering::Relaxed);
            if others >= 2 * MOST_CONNECTIONS {
                self.count.fetch_sub(1, Ordering::Relaxed);
                continue; // too many even to tell them
            }
            let shared = self.clone();
            let serve = move || {
                let served = match others >= MOST_CONNECTIONS {
                    true => refuse(&stream, None, &format!("there are {MOST_CONNECTIONS} connections already")),
                    false => shared.serve(Client(number), &stream),
                };
                if let Err(error) = served.and_then(|()| close(&stream)) {
                    tracing::debug!("client {number}: {error}");
                }
                shared.count.fetch_sub(1, Ordering::Relaxed);
            };
            if let Err(error) = std::thread::Builder::new().spawn(serve) {
                self.count.fetch_sub(1, Ordering::Relaxed);
                tracing::warn!("no thread for a client: {error}");
            }
        }
    }

    /// Reads hello and then requests until the client leaves.
    fn serve(&self, client: Client, stream: &TcpStream) -> io::Result<()> {
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(HELLO_TIME))?;
        let mut from = BufReader::new(stream);
        let deadline = Instant::now() + HELLO_TIME;
        let wait = || match deadline.saturating_duration_since(Instant::now()) {
            Duration::ZERO => Err(ErrorKind::TimedOut.into()),
            left => stream.set_read_timeout(Some(left)),
        };
        let hello = match read_line(&mut from, MOST_HELLO, wait) {
            Ok(None) => return Ok(()),
            Ok(Some(line)) => self.hello(&line),
            Err(error) => match error.kind() {
                ErrorKind::InvalidData => Err((None, error.to_string())),
                ErrorKind::TimedOut | ErrorKind::WouldBlock => {
                    Err((None, format!("no hello within {} seconds", HELLO_TIME.as_secs())))
                }
                _ => return Err(error),
            },
        };
        let (id, name) = match hello {
            Ok(hello) => hello,
            Err((id, reason)) => return refuse(stream, id, &reason),
        };
        stream.set_read_timeout(None)?;
        stream.set_write_timeout(None)?;
        let unanswered = self.join(client, name, stream.try_clone()?, Some((stream.try_clone()?, id)));
        let read = self.read(client, &mut from, &unanswered);
        self.leave(client);
        read
    }

    /// Checks the first line. Returns id and name of the client, or id and reason.
    fn hello(&self, line: &[u8]) -> std::result::Result<(Option<u64>, String), (Option<u64>, String)> {
        let refuse = |id, reason: &str| Err((id, reason.to_owned()));
        match parse(line) {
            (id, Ok(Request::Hello { protocol, .. })) if protocol != PROTOCOL => {
                refuse(id, &format!("protocol {protocol} is not spoken here, but {PROTOCOL}"))
            }
            (id, Ok(Request::Hello { token, .. })) if !is_same(&token, &self.token) => refuse(id, "wrong token"),
            (id, Ok(Request::Hello { name, .. })) => {
                Ok((id, name.chars().filter(|c| !c.is_control()).take(64).collect()))
            }
            (id, Ok(_)) => refuse(id, "the first message must be hello"),
            (id, Err(reason)) => refuse(id, &reason),
        }
    }

    /// Starts the thread that writes. `socket`: with the id of hello, which is answered.
    fn join(
        &self,
        client: Client,
        name: String,
        mut to: impl Write + Send + 'static,
        socket: Option<(TcpStream, Option<u64>)>,
    ) -> Arc<Unanswered> {
        let (outbox, lines) = channel::<Vec<u8>>();
        let waiting = Arc::new(AtomicUsize::new(0));
        let last_read = Arc::new(Mutex::new(Instant::now()));
        let (written, taken) = (waiting.clone(), last_read.clone());
        std::thread::spawn(move || {
            for line in lines {
                for chunk in line.chunks(CHUNK) {
                    if to.write_all(chunk).is_err() {
                        return;
                    }
                    written.fetch_sub(chunk.len(), Ordering::Relaxed);
                    *taken.lock().expect("no thread panics while it holds this lock") = Instant::now();
                }
                if to.flush().is_err() {
                    return;
                }
            }
        });
        let unanswered = Arc::new(Unanswered { count: Mutex::new(Some(0)), fewer: Condvar::new() });
        let (socket, id) = socket.map_or((None, None), |(socket, id)| (Some(socket), id));
        let connection = Connection { name, outbox, waiting, last_read, unanswered: unanswered.clone(), socket };
        let mut hello = json!({ "ok": true, "protocol": PROTOCOL, "relume": env!("CARGO_PKG_VERSION") });
        if let Some(id) = id {
            hello["id"] = id.into();
        }
        connection.send(line(&hello));
        self.clients().insert(client, connection);
        (self.on)(Inbound::Joined(client));
        unanswered
    }

    fn read(&self, client: Client, from: &mut impl BufRead, unanswered: &Unanswered) -> io::Result<()> {
        loop {
            let line = match read_line(from, MOST_LINE, || Ok(())) {
                Ok(None) => return Ok(()),
                Ok(Some(line)) => Ok(line),
                Err(error) if error.kind() == ErrorKind::InvalidData => Err(error.to_string()),
                Err(error) => return Err(error),
            };
            let goes_on = line.is_ok();
            let (id, request) = match line.map(|line| parse(&line)) {
                Ok((id, Ok(Request::Hello { .. }))) => (id, Err("hello was said already".into())),
                Ok(parsed) => parsed,
                Err(reason) => (None, Err(reason)),
            };
            if !unanswered.add() {
                return Ok(());
            }
            (self.on)(Inbound::Request(Pending { client, id }, request));
            if !goes_on {
                return Ok(());
            }
        }
    }

    /// The owner answers what was asked before, and then [forgets](Server::forget) the client.
    fn leave(&self, client: Client) {
        (self.on)(Inbound::Left(client));
    }
}

fn refusal(id: Option<u64>, reason: &str) -> Vec<u8> {
    line(&id.map_or_else(|| json!({ "error": reason }), |id| json!({ "id": id, "error": reason })))
}

fn refuse(mut stream: &TcpStream, id: Option<u64>, reason: &str) -> io::Result<()> {
    stream.write_all(&refusal(id, reason))
}

/// Ends a connection. What the client still sends is read, as otherwise it might never see the last answer.
fn close(mut stream: &TcpStream) -> io::Result<()> {
    stream.shutdown(Shutdown::Write)?;
    let deadline = Instant::now() + CLOSING_TIME;
    let mut rest = [0; 4096];
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(());
        }
        stream.set_read_timeout(Some(left))?;
        if stream.read(&mut rest)? == 0 {
            return Ok(());
        }
    }
}

/// Compares in a time that does not tell how much is the same.
fn is_same(a: &str, b: &str) -> bool {
    a.len() == b.len() && a.bytes().zip(b.bytes()).fold(0, |differs, (a, b)| differs | (a ^ b)) == 0
}
