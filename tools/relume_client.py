"""Reads and edits the lights of `relume view --listen FILE` or `relume serve --listen FILE`: docs/protocol.md.

    python3 tools/relume_client.py FILE '{"do": "rig"}'
"""

import json
import socket
import sys


class Refused(Exception):
    """relume's answer was an error."""


class Client:
    def __init__(self, file, name="python", timeout=60):
        with open(file, encoding="utf-8") as opened:
            where = json.load(opened)
        self.socket = socket.create_connection((where["host"], where["port"]), timeout)
        self.lines = self.socket.makefile("rb")
        self.events, self.last_id = [], 0  # events that nobody has waited for yet
        self.ask("hello", protocol=1, token=where["token"], name=name)

    def ask(self, what, **members):
        """Sends a request and returns its answer; events that come before it are kept."""
        self.last_id += 1
        message = {"do": what, "id": self.last_id, **members}
        self.socket.sendall(json.dumps(message).encode() + b"\n")
        while True:
            answer = self.read()
            if "event" in answer:
                self.events.append(answer)
            elif "error" in answer:
                raise Refused(answer["error"])
            elif answer.get("id") == self.last_id:
                return answer

    def wait(self, name, **members):
        """Returns the next event of this name with these members."""
        while True:
            event = self.events.pop(0) if self.events else self.read()
            if event.get("event") == name and all(event.get(key) == value for key, value in members.items()):
                return event

    def edit(self, lights, **members):
        """Changes lights: {"key": {"stops": 1}}; None deletes. Returns the answer."""
        return self.ask("edit", rig={"lights": lights}, **members)

    def read(self):
        line = self.lines.readline()
        if not line:
            raise ConnectionError("relume has closed the connection")
        return json.loads(line)


if __name__ == "__main__":
    client = Client(sys.argv[1])
    client.wait("opened")
    for request in map(json.loads, sys.argv[2:]):
        print(json.dumps(client.ask(request.pop("do"), **request), indent=1))
