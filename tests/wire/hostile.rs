//! Nonsense, half-open connections, slow readers and crowds get clear answers or are closed, and nobody else suffers.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::{Value, json};

use crate::client::{Client, Serve, address, connect};
use crate::common::random::Random;

fn balls() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/balls-2.glb")
}

/// All that a connection says until it is closed.
fn rest(mut stream: TcpStream) -> String {
    let mut said = String::new();
    stream.read_to_string(&mut said).unwrap();
    said
}

/// Whether a server still does what it should.
fn is_well(serve: &Serve) {
    let (mut client, _) = Client::opened(&serve.file, "");
    client.edit(json!({ "point0": { "stops": 1 } })).unwrap();
    client.ask(json!({ "do": "undo" })).unwrap();
    client.ask(json!({ "do": "picture" })).unwrap();
}

/// A request with bytes, words or members replaced, repeated or left out.
fn damaged(random: &mut Random) -> Vec<u8> {
    let good = [
        r#"{"do": "edit", "id": 1, "rig": {"lights": {"point0": {"position": [0, 1, 2], "stops": 1.5}}}}"#,
        r#"{"do": "edit", "id": 1, "gesture": "g", "rig": {"groups": {"g": {"stops": 1, "color": [1, 2, 3]}}}}"#,
        r#"{"do": "edit", "rig": {"lights": {"n": {"kind": "spot", "position": [0, 1, 2], "direction": [0, 1, 0]}}}}"#,
        r#"{"do": "edit", "rig": {"sets": {"s": ["Ball"]}, "lights": {"spot1": null}}}"#,
        r#"{"do": "picture", "format": "png", "exposure": 1}"#,
        r#"{"do": "undo"}"#,
        r#"{"do": "rig", "id": 3}"#,
    ];
    let words = ["null", "-1", "1e308", "[]", "{}", "\"\"", "true", "18446744073709551616", "\"point0\"", "1e-320"];
    let mut line = random.pick(&good).to_owned();
    for _ in 0..random.below(4) {
        let parts: Vec<&str> = line.split_inclusive([' ', ':', ',', '[', '{']).collect();
        let at = random.below(parts.len());
        let mut parts: Vec<String> = parts.into_iter().map(str::to_owned).collect();
        match random.below(4) {
            0 => drop(parts.remove(at)),
            1 => parts[at] = format!("{},", random.pick(&words)),
            2 => parts[at] = random.pick(&words).to_owned(),
            _ => parts.insert(at, parts[random.below(parts.len())].clone()),
        }
        line = parts.concat();
    }
    let mut line = line.into_bytes();
    for _ in 0..random.below(3) {
        let at = random.below(line.len().max(1));
        if let Some(byte) = line.get_mut(at) {
            *byte = random.pick(&[0, 9, 34, 46, 91, 125, 195, 255]);
        }
    }
    line.retain(|byte| *byte != b'\n');
    line
}

#[test]
fn ten_thousand_damaged_lines_are_answered_one_by_one() {
    let serve = Serve::start(&balls(), "32x24");
    let (mut client, _) = Client::opened(&serve.file, "");
    let mut random = Random::new(1);
    let (mut done, mut refused) = (0, 0);
    for _ in 0..100 {
        let lines: Vec<Vec<u8>> = (0..100).map(|_| damaged(&mut random)).collect();
        lines.iter().for_each(|line| client.write(line));
        let mut answers = 0;
        while answers < lines.len() {
            let answer = client.read().expect("it goes on");
            if answer.get("event").is_some() {
                continue;
            }
            answers += 1;
            match answer["error"].as_str() {
                Some(error) => {
                    assert!(!error.is_empty() && error.len() < 1000 && !error.contains("panic"), "{error}");
                    refused += 1;
                }
                None => {
                    assert_eq!(answer["ok"], true, "{answer}");
                    done += 1;
                }
            }
        }
    }
    assert!(done > 500 && refused > 5000, "{done} {refused}");
    // Whatever it became, it is a rig that a file can store.
    let rig = client.rig();
    assert!(rig["lights"].as_object().is_some_and(|lights| lights.values().all(Value::is_object)), "{rig}");
    client.ask(json!({ "do": "picture" })).unwrap();
}

#[test]
fn answers_come_in_the_order_of_requests() {
    let serve = Serve::start(&balls(), "32x24");
    let (mut client, _) = Client::opened(&serve.file, "");
    for id in (0..30).step_by(3) {
        client.write(json!({ "do": "picture", "id": id }).to_string().as_bytes());
        client.write(json!({ "do": "nonsense", "id": id + 1 }).to_string().as_bytes());
        client.write(json!({ "do": "rig", "id": id + 2 }).to_string().as_bytes());
    }
    let mut ids = Vec::new();
    while ids.len() < 30 {
        ids.extend(client.read().expect("it goes on")["id"].as_u64());
    }
    assert!(ids.is_sorted(), "{ids:?}");
}

#[test]
fn nobody_enters_without_the_token() {
    let serve = Serve::start(&balls(), "32x24");
    let token = address(&serve.file).1;
    let other = format!("{}0", &token[1..]);
    for (hello, reason) in [
        (json!({ "do": "hello", "protocol": 1, "token": other, "id": 9 }).to_string(), "wrong token"),
        (json!({ "do": "hello", "protocol": 1 }).to_string(), "wrong token"),
        (json!({ "do": "hello", "protocol": 2, "token": token }).to_string(), "protocol 2 is not spoken here"),
        (json!({ "do": "rig" }).to_string(), "the first message must be hello"),
        ("POST / HTTP/1.1".into(), "not JSON"),
        ("\u{16}\u{3}\u{1}".into(), "not JSON"),
        ("x".repeat(5000), "more than 4096 bytes"),
    ] {
        let mut stream = connect(&serve.file);
        stream.write_all(hello.as_bytes()).unwrap();
        stream.write_all(b"\n{\"do\": \"undo\"}\n").unwrap();
        let said = rest(stream);
        assert!(said.contains(reason) && said.lines().count() == 1, "{hello}: {said}");
    }
    let (mut client, _) = Client::opened(&serve.file, "");
    let again = client.ask(json!({ "do": "hello", "protocol": 1, "token": token }));
    assert_eq!(again, Err("hello was said already".into()));
    is_well(&serve);
}

#[test]
fn half_open_connections_are_closed_and_do_not_keep_others_out() {
    let serve = Serve::start(&balls(), "32x24");
    let mut silent: Vec<TcpStream> = (0..60).map(|_| connect(&serve.file)).collect();
    // These say half a line, or go away in the middle of one.
    for stream in &mut silent[..20] {
        stream.write_all(b"{\"do\": \"hel").unwrap();
    }
    silent[..10].iter().for_each(|stream| stream.shutdown(Shutdown::Write).unwrap());
    is_well(&serve);
    for (number, stream) in silent.into_iter().enumerate() {
        let said = rest(stream);
        let expected = if number < 10 { "" } else { "no hello within 10 seconds" };
        assert!(said.contains(expected) && said.is_empty() == expected.is_empty(), "{number}: {said}");
    }
    is_well(&serve);
}

#[test]
fn a_hundred_clients_see_the_same_and_more_are_refused() {
    let serve = Serve::start(&balls(), "32x24");
    let mut clients: Vec<Client> = (0..100).map(|i| Client::opened(&serve.file, &format!("client {i}")).0).collect();
    for i in [0, 99] {
        clients[i].edit(json!({ "point0": { "stops": i } })).unwrap();
    }
    for (i, client) in clients.iter_mut().enumerate() {
        let of_last = |event: &Value| event["event"] == "edited" && event["by"] == "client 99";
        if i != 99 {
            assert_eq!(client.wait_for(of_last)["rig"]["lights"]["point0"]["stops"], 99.0);
        }
    }
    let more: Vec<TcpStream> = (0..40).map(|_| connect(&serve.file)).collect();
    std::thread::sleep(Duration::from_millis(100));
    let said = rest(connect(&serve.file));
    assert!(said.contains("there are 128 connections already"), "{said}");
    drop(more);
    clients[50].edit(json!({ "point0": { "stops": 0 } })).unwrap();
    drop(clients);
    // Their threads end, so that others have room.
    std::thread::sleep(Duration::from_millis(500));
    is_well(&serve);
}

#[test]
fn a_client_that_does_not_read_is_closed_and_delays_nobody() {
    let serve = Serve::start(&balls(), "1024x768");
    let (mut slow, _) = Client::opened(&serve.file, "slow");
    let (mut other, _) = Client::opened(&serve.file, "other");
    // 4 MiB each.
    let asked = std::thread::spawn(move || {
        let request = json!({ "do": "picture", "format": "rgba8" }).to_string() + "\n";
        (0..100).all(|_| slow.stream.write_all(request.as_bytes()).is_ok()).then_some(slow)
    });
    for stops in 0..20 {
        other.edit(json!({ "point0": { "stops": stops } })).unwrap();
    }
    // `None`: it was closed while it still asked.
    if let Some(mut slow) = asked.join().unwrap() {
        let mut left = 0;
        std::thread::sleep(Duration::from_secs(4)); // longer than a reader may stop
        other.edit(json!({ "point0": { "stops": 0 } })).unwrap();
        let mut buffer = vec![0; 1 << 20];
        while let Ok(count @ 1..) = slow.stream.read(&mut buffer) {
            left += count;
        }
        assert!(left < 80 << 20, "{left} bytes: it was never closed");
    }
    is_well(&serve);
}

#[test]
fn a_line_that_does_not_end_is_refused() {
    let serve = Serve::start(&balls(), "32x24");
    let (client, _) = Client::opened(&serve.file, "");
    let mut stream = client.stream.try_clone().unwrap();
    let chunk = vec![b'['; 1 << 20];
    // What comes before the connection is closed is read and thrown away.
    assert!((0..1 << 16).any(|_| stream.write_all(&chunk).is_err()), "64 GiB without an end were read");
    drop(client);
    is_well(&serve);
}

/// Only the loopback address is bound, and only this user can read the token.
#[cfg(target_os = "linux")]
#[test]
fn no_other_address_is_bound() {
    use std::os::unix::fs::PermissionsExt;
    let serve = Serve::start(&balls(), "32x24");
    assert_eq!(std::fs::metadata(&serve.file).unwrap().permissions().mode() & 0o777, 0o600);
    let fds = std::fs::read_dir(format!("/proc/{}/fd", serve.child.id())).unwrap();
    let links: Vec<String> = fds
        .flatten()
        .filter_map(|fd| Some(std::fs::read_link(fd.path()).ok()?.to_string_lossy().into_owned()))
        .collect();
    let mut bound = Vec::new();
    for table in ["tcp", "tcp6", "udp", "udp6"] {
        for row in std::fs::read_to_string(format!("/proc/net/{table}")).unwrap_or_default().lines().skip(1) {
            let columns: Vec<&str> = row.split_whitespace().collect();
            if links.contains(&format!("socket:[{}]", columns[9])) {
                bound.push((table, columns[1].to_owned()));
            }
        }
    }
    assert_eq!(bound, [("tcp", format!("0100007F:{:04X}", address(&serve.file).0))]);
}
