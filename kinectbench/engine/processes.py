"""Worker processes that end with their parent, also when it is interrupted or killed."""

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

# fork after numba or Open3D has started threads hangs or dies.
CONTEXT = multiprocessing.get_context("spawn")


@contextmanager
def worker_pool(
    workers: int, prepare: Callable[..., None] | None = None, arguments: tuple[object, ...] = ()
) -> Iterator[ProcessPoolExecutor]:
    """A pool of spawned processes; if the block raises an exception, they are stopped at once.

    Args:
        workers: most processes at a time.
        prepare: module-level function, called in each worker before its first task.
        arguments: of `prepare`.
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
            # It gives back what the processes shared: an exit must not come in the middle of that.
            manager.join(GRACE_S)
        raise
    finally:
        pool.shutdown(wait=True)


def submit_all(
    pool: ProcessPoolExecutor, function: Callable[[Task], Result], tasks: Iterable[Task]
) -> list[Future[Result]]:
    """Hand every task to the pool, whose processes start now; Ctrl-C is their parent's to answer."""
    resource_tracker.ensure_running()  # starting it later would unblock the signal
    with interrupts_held():
        return [pool.submit(function, task) for task in tasks]


def give_back_shared() -> None:
    """Unlink the semaphores that processes shared, for an exit that runs no exit handlers.

    Left alone they are unlinked too, but by a helper process of the library that complains about them.
    """
    util._run_finalizers(0)  # type: ignore[attr-defined]


def give_back_memory() -> None:
    """Give memory that is free to the system: glibc keeps what lies between blocks in use.

    The peak of a build of 1,000 frames of 640x480 on two threads is 1.21 GB by that, and was 1.52 GB.
    """
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)


def _start_worker(prepare: Callable[..., None] | None, arguments: tuple[object, ...]) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare(*arguments)


def _end_with_parent() -> None:
    """End with the parent: a killed parent cannot stop its workers, which would wait for ever."""
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
