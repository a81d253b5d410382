"""An S3 server of moto's in a process of its own, with buckets that are made for one test each."""

import itertools
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from dataclasses import dataclass


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port: int = taken.getsockname()[1]
        return port


# No bucket has the name of one of another server: clients are kept by their URLs.
_numbers = itertools.count()


@dataclass
class S3Server:
    """The server; what it holds is in its memory and goes with it."""

    port: int
    process: "subprocess.Popen[bytes]"

    def bucket(self) -> str:
        """Make a bucket; its name."""
        name = f"bucket{next(_numbers)}"
        url = f"http://127.0.0.1:{self.port}/{name}"
        with urllib.request.urlopen(urllib.request.Request(url, method="PUT"), timeout=30):
            return name

    def variables(self, port: int | None = None) -> dict[str, str]:
        """What the environment must say for a client to use it, or a proxy before it on another port."""
        return {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port or self.port}",
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_REGION": "us-east-1",
        }

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


def start_s3() -> S3Server:
    """Start a server and wait until it answers."""
    port = free_port()
    process = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={name: value for name, value in os.environ.items() if not name.startswith("AWS_")},
    )
    end = time.monotonic() + 60
    while True:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/moto-api/", timeout=5):
                return S3Server(port, process)
        except OSError:
            assert process.poll() is None and time.monotonic() < end, "moto did not start"
            time.sleep(0.05)
