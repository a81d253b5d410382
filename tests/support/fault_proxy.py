"""A proxy between a client and a store that counts requests and, when told, answers badly."""

import asyncio
import threading
import time
from collections.abc import Callable
from typing import Literal

# 503: answered without doing it; cut: the connection ends in the midst of the request's body; lose: it is
# done, and the connection ends before the answer; drop: the connection ends at once.
Fault = Literal["", "503", "cut", "lose", "drop"]
# Which fault a request meets, by its number from 0, method and path.
Choose = Callable[[int, str, str], Fault]

BUSY = (
    b"HTTP/1.1 503 Service Unavailable\r\nContent-Type: application/xml\r\nContent-Length: 55\r\n"
    b"Connection: close\r\n\r\n<Error><Code>SlowDown</Code><Message>x</Message></Error>"
)


class FaultProxy:
    """An HTTP proxy on a port of its own, in a thread; a context manager.

    Attributes:
        requests: (method, path) of all so far, those that met a fault included.
        choose: may be replaced at any time.
        latency_s: waited before each request goes on.
    """

    def __init__(self, upstream_port: int, choose: Choose = lambda number, method, path: "") -> None:
        self.requests: list[tuple[str, str]] = []
        self.faults: list[Fault] = []
        self.choose = choose
        self.latency_s = 0.0
        self._upstream = upstream_port
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)

    def __enter__(self) -> "FaultProxy":
        self._thread.start()
        starting = asyncio.run_coroutine_threadsafe(
            asyncio.start_server(self._serve, "127.0.0.1", 0), self._loop
        )
        self._server = starting.result(10)
        self.port: int = self._server.sockets[0].getsockname()[1]
        return self

    def __exit__(self, *error: object) -> None:
        async def end() -> None:
            self._server.close()
            await asyncio.sleep(0)  # a connection that was just accepted starts a task of its own
            while tasks := asyncio.all_tasks() - {asyncio.current_task()}:
                # A task that is cancelled while it connects would leave its socket open.
                _, tasks = await asyncio.wait(tasks, timeout=1)
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
            await asyncio.sleep(0)  # the loop lets go of closed connections in its next round

        asyncio.run_coroutine_threadsafe(end(), self._loop).result(10)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10)
        self._loop.close()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await self._answer(reader, writer)
        except (ConnectionError, asyncio.IncompleteReadError):
            pass
        finally:
            writer.close()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One request of a connection: each has its own, as the answers say `Connection: close`."""
        head = await reader.readuntil(b"\r\n\r\n")
        first, *lines = head.decode("latin-1").rstrip().split("\r\n")
        method, path, _ = first.split(" ")
        headers = dict(line.lower().split(": ", 1) for line in lines if ": " in line)
        fault = self.choose(len(self.requests), method, path)
        self.requests.append((method, path))
        self.faults.append(fault)
        length = int(headers.get("content-length", 0))
        if fault == "drop":
            return
        if fault == "cut":
            await reader.readexactly(length // 2)
            return
        body = await reader.readexactly(length)
        if fault == "503":
            writer.write(BUSY)
            await writer.drain()
            return
        if self.latency_s:
            await asyncio.sleep(self.latency_s)
        answer = await self._forward(first, lines, body)
        if fault != "lose":
            writer.write(answer)
            await writer.drain()

    async def _forward(self, first: str, lines: list[str], body: bytes) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", self._upstream)
        try:
            kept = [line for line in lines if not line.lower().startswith("connection:")]
            writer.write("\r\n".join([first, *kept, "Connection: close", "", ""]).encode("latin-1") + body)
            await writer.drain()
            return await reader.read(-1)
        finally:
            writer.close()


def for_a_while(seconds: float, fault: Fault = "503") -> Choose:
    """The fault for so long from the first request on."""
    started: list[float] = []

    def choose(number: int, method: str, path: str) -> Fault:
        if not started:
            started.append(time.monotonic())
        return fault if time.monotonic() - started[0] < seconds else ""

    return choose
