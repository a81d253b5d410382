"""Worker processes that end with their parent, even if it is interrupted or killed."""

import ctypes
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker, util
from typing import TYPE_CHECKING, Any, TypeVar

from kinectbench.engine.interrupts import interrupts_held

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

Task = TypeVar("Task")
Result = TypeVar("Result")

KILLED = "a worker process was killed, perhaps for lack of memory; run again with --jobs 1"
GRACE_S = 5.0

# Not fork: a forked process hangs or dies if numba or Open3D has started threads.
CONTEXT = multiprocessing.get_context("spawn")


@contextmanager
def worker_pool(
    workers: int, prepare: Callable[..., None] | None = None, arguments: tuple[object, ...] = ()
) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of spawned processes; if the block raises an exception, they are stopped at once.

    `prepare` is a module-level function, called in each worker with `arguments` before its first task.
    """
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        workers, mp_context=CONTEXT, initializer=_start_worker, initargs=(prepare, arguments)
    )
    try:
        yield pool
    except BaseException:
        manager: Any = pool._executor_manager_thread
        pool.shutdown(wait=False, cancel_futures=True)
        _end(set(multiprocessing.active_children()) - others)
        if manager is not None:
            # The manager thread frees what the processes shared: an exit must not interrupt it.
            manager.join(GRACE_S)
        raise
    finally:
        pool.shutdown(wait=True)


def submit_all(
    pool: ProcessPoolExecutor, function: Callable[[Task], Result], tasks: Iterable[Task]
) -> list[Future[Result]]:
    """Submit all tasks. This starts the processes; they ignore Ctrl-C, because their parent handles it."""
    resource_tracker.ensure_running()  # started later, it would unblock the signal
    with interrupts_held():
        return [pool.submit(function, task) for task in tasks]


def give_back_shared() -> None:
    """Unlink semaphores that processes shared; call it before an exit that skips exit handlers.

    Otherwise a helper process of the library unlinks them and prints warnings.
    """
    util._run_finalizers(0)  # type: ignore[attr-defined]


def give_back_memory() -> None:
    """Return free memory to the system: glibc keeps free memory that lies between used blocks.

    This lowers the peak of a build of 1,000 frames of 640x480 on two threads from 1.52 to 1.21 GB.
    """
    with suppress(OSError, AttributeError):  # the C library is not glibc
        ctypes.CDLL(None).malloc_trim(0)


def _start_worker(prepare: Callable[..., None] | None, arguments: tuple[object, ...]) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare(*arguments)


def _end_with_parent() -> None:
    """Wait for the parent to end, then end this process: a killed parent cannot stop its workers."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _end(processes: set["BaseProcess"]) -> None:
    for process in processes:
        process.terminate()
    for process in processes:
        process.join(GRACE_S)
        if process.is_alive():
            process.kill()
