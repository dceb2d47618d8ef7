"""A connection to relume that never waits: docs/protocol.md has the messages."""

import json
import socket
from pathlib import Path

PROTOCOL = 1
# Bytes read at a time.
CHUNK = 1 << 16


class Lost(Exception):
    """relume has gone, or refused the connection."""


class Connection:
    # Id of the first request.
    HELLO = 1

    def __init__(self, file, name="Blender"):
        """Raises Lost if nobody listens."""
        try:
            where = json.loads(Path(file).read_text(encoding="utf-8"))
            port, token, self.process = where["port"], where["token"], where["pid"]
            self.socket = socket.create_connection(("127.0.0.1", port), timeout=1)
        except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
            raise Lost(str(error)) from error
        self.socket.setblocking(False)
        self.incoming, self.outgoing, self.last_id, self.has_ended = b"", b"", 0, False
        self.request("hello", protocol=PROTOCOL, token=token, name=name)

    def request(self, what, **members):
        """Sends a request soon; returns its id."""
        self.last_id += 1
        self.outgoing += json.dumps({"do": what, "id": self.last_id, **members}).encode() + b"\n"
        return self.last_id

    def flush(self):
        """Sends what is possible now. Raises Lost."""
        while self.outgoing:
            try:
                self.outgoing = self.outgoing[self.socket.send(self.outgoing) :]
            except BlockingIOError:
                return
            except OSError as error:
                raise Lost(str(error)) from error

    def receive(self):
        """The messages that have come. Raises Lost once all have been returned."""
        if self.has_ended:
            raise Lost("relume has closed the connection")
        while not self.has_ended:
            try:
                chunk = self.socket.recv(CHUNK)
            except BlockingIOError:
                break
            except OSError as error:
                raise Lost(str(error)) from error
            self.has_ended = not chunk
            self.incoming += chunk
        *lines, self.incoming = self.incoming.split(b"\n")
        return [json.loads(line) for line in lines]

    def close(self):
        self.socket.close()
