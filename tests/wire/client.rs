//! A client, and the server that it speaks with.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::command::relume;

/// Longest that anything may take; machines are shared.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// `relume serve` of a scene, with direct light only.
pub struct Serve {
    pub child: Child,
    pub file: PathBuf,
    _folder: tempfile::TempDir,
}

impl Serve {
    pub fn start(scene: &Path, size: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("connection.json");
        let mut command = relume();
        command.args(["serve", "--size", size, "--gi", "off", "--no-cache", "--listen"]).arg(&file).arg(scene);
        let child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut serve = Self { child, file, _folder: folder };
        serve.wait_for_file();
        serve
    }

    fn wait_for_file(&mut self) {
        let start = Instant::now();
        while !self.file.exists() {
            assert!(start.elapsed() < PATIENCE, "nobody listens");
            if let Some(status) = self.child.try_wait().unwrap() {
                let mut said = String::new();
                self.child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
                panic!("{status}: {said}");
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Serve {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Port and token that a connection file names.
pub fn address(file: &Path) -> (u16, String) {
    let content: Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    (content["port"].as_u64().unwrap() as u16, content["token"].as_str().unwrap().to_owned())
}

/// A connection that has said nothing yet.
pub fn connect(file: &Path) -> TcpStream {
    let stream = TcpStream::connect(("127.0.0.1", address(file).0)).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

pub struct Client {
    pub stream: TcpStream,
    from: BufReader<TcpStream>,
    events: Vec<Value>,
    last_id: u64,
}

impl Client {
    /// Says hello.
    pub fn new(file: &Path, name: &str) -> Self {
        let stream = connect(file);
        let from = BufReader::new(stream.try_clone().unwrap());
        let mut client = Self { stream, from, events: Vec::new(), last_id: 0 };
        let token = address(file).1;
        client.ask(json!({ "do": "hello", "protocol": 1, "token": token, "name": name })).unwrap();
        client
    }

    /// Joined and told of the scene.
    pub fn opened(file: &Path, name: &str) -> (Self, Value) {
        let mut client = Self::new(file, name);
        let opened = client.wait("opened");
        (client, opened)
    }

    pub fn write(&mut self, line: &[u8]) {
        self.stream.write_all(&[line, b"\n"].concat()).unwrap();
    }

    /// Sends a request; its answer, or the error in it.
    pub fn ask(&mut self, mut request: Value) -> Result<Value, String> {
        self.last_id += 1;
        request["id"] = self.last_id.into();
        self.write(request.to_string().as_bytes());
        loop {
            let answer = self.read().expect("it answers");
            if answer.get("event").is_some() {
                self.events.push(answer);
            } else if answer["id"] == self.last_id {
                return answer["error"].as_str().map_or(Ok(answer.clone()), |error| Err(error.to_owned()));
            }
        }
    }

    /// Edits lights.
    pub fn edit(&mut self, lights: Value) -> Result<Value, String> {
        self.ask(json!({ "do": "edit", "rig": { "lights": lights } }))
    }

    pub fn rig(&mut self) -> Value {
        self.ask(json!({ "do": "rig" })).unwrap()["rig"].take()
    }

    /// The next event of this name.
    pub fn wait(&mut self, name: &str) -> Value {
        self.wait_for(|event| event["event"] == name)
    }

    pub fn wait_for(&mut self, is: impl Fn(&Value) -> bool) -> Value {
        loop {
            let event = if self.events.is_empty() { self.read().expect("it goes on") } else { self.events.remove(0) };
            if is(&event) {
                return event;
            }
        }
    }

    /// `None` once the server has closed the connection.
    pub fn read(&mut self) -> Option<Value> {
        let mut line = String::new();
        self.from.read_line(&mut line).unwrap();
        (!line.is_empty()).then(|| serde_json::from_str(&line).unwrap())
    }
}
