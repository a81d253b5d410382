"""Results come in order and are the same, however many threads there are."""

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from kinectbench.core.threads import ahead, both, in_parts, using_threads


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_order(threads: int) -> None:
    waiting = threading.Event()

    def late_first(item: int) -> int:
        if item == 0 and threads > 1:
            waiting.wait(10)  # the second overtakes it
        waiting.set()
        return item * item

    with using_threads(threads):
        assert list(ahead(late_first, range(20))) == [n * n for n in range(20)]
        assert list(ahead(late_first, [])) == []


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_no_more_is_begun_than_threads_can_use(threads: int) -> None:
    taken = 0

    def items() -> Iterator[int]:
        nonlocal taken
        for n in range(100):
            taken += 1
            yield n

    with using_threads(threads):
        for used, _ in enumerate(ahead(abs, items()), start=1):
            assert taken <= used + threads + 1
            if used == 10:
                break


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_comes_in_its_place(threads: int) -> None:
    def odd_one(item: int) -> int:
        if item == 7:
            raise ValueError("seven")
        return item

    found = []
    with using_threads(threads), pytest.raises(ValueError, match="seven"):
        for result in ahead(odd_one, range(50)):
            found.append(result)
    assert found == list(range(7))


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_of_the_items_comes_in_its_place(threads: int) -> None:
    """After the results before it, and after an earlier error of the function."""

    def items() -> Iterator[int]:
        yield from range(7)
        raise ValueError("no eighth")

    found = []
    with using_threads(threads), pytest.raises(ValueError, match="no eighth"):
        for result in ahead(abs, items()):
            found.append(result)
    assert found == list(range(7))

    def odd_one(item: int) -> int:
        if item == 5:
            raise ValueError("five")
        return item

    with using_threads(threads), pytest.raises(ValueError, match="five"):
        list(ahead(odd_one, items()))


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("count", [0, 1, 3, 1000])
def test_parts_cover_everything_once(threads: int, count: int) -> None:
    touched = np.zeros(count, int)

    def touch(start: int, stop: int) -> None:
        touched[start:stop] += 1

    with using_threads(threads):
        in_parts(touch, count)
    assert (touched == 1).all()


@pytest.mark.parametrize("threads", [1, 2])
def test_both_results_and_either_error(threads: int) -> None:
    begun = threading.Event()

    def first() -> str:
        assert threads == 1 or begun.wait(10)  # the second runs beside it
        return "first"

    def second() -> int:
        begun.set()
        return 2

    def fails() -> int:
        raise ValueError("fails")

    with using_threads(threads):
        assert both(first, second) == ("first", 2)
        for pair in ((fails, second), (second, fails)):
            with pytest.raises(ValueError, match="fails"):
                both(*pair)


def test_threads_are_one_elsewhere() -> None:
    seen: set[str] = set()

    def name(_: int) -> None:
        seen.add(threading.current_thread().name)

    list(ahead(name, range(5)))
    assert seen == {threading.current_thread().name}
    with using_threads(4):
        # Within a thread that was started here there are no more.
        inner = list(ahead(lambda _: len({*ahead(lambda _: threading.get_ident(), range(8))}), range(4)))
    assert inner == [1, 1, 1, 1]
