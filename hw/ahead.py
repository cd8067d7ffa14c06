"""Background threads with bounded queues: `Ahead` prefetches an iterator, `prefetched` computes its results,
`in_background` runs calls.
"""

import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Generic, ParamSpec, TypeVar

T = TypeVar("T")
Result = TypeVar("Result")
P = ParamSpec("P")

_PUNCTUAL_S = 0.0005  # a timing thread waits no longer than this for Python's lock


class Ahead(Generic[T]):
    """Prefetches up to `most` items of an iterator in a thread, which starts at the first request.

    Exceptions of the iterator are raised in their place. Can be iterated once; the thread has stopped when that
    ends. `waited_s`: how long the thread waited because the buffer was full.
    """

    def __init__(self, items: Iterator[T], most: int) -> None:
        self._items = items
        # SimpleQueue is written in C: Ctrl-C in the main thread leaves no lock taken.
        self._ready: SimpleQueue[tuple[T] | BaseException | None] = SimpleQueue()
        self._room: SimpleQueue[None] = SimpleQueue()
        for _ in range(most):
            self._room.put(None)
        self._stopping = False
        self._thread = Thread(target=self._run, name="ahead", daemon=True)
        self.waited_s = 0.0

    def __iter__(self) -> Iterator[T]:
        with _punctual():
            try:
                self._thread.start()
                while (item := self._ready.get()) is not None:
                    if isinstance(item, BaseException):
                        raise item
                    yield item[0]
                    self._room.put(None)
            finally:
                self.stop()

    def stop(self) -> None:
        """Stop the thread and wait for it, however often that is interrupted: the caller then closes its devices."""
        self._stopping = True
        self._room.put(None)
        interrupted: BaseException | None = None
        while self._thread.is_alive():
            try:
                self._thread.join()
            except BaseException as error:
                interrupted = error
        if interrupted is not None:
            raise interrupted

    def _run(self) -> None:
        try:
            while self._wait_for_room() and (item := next(self._items, self)) is not self:
                self._ready.put((item,))  # type: ignore[arg-type]  # self stands for the end
        except BaseException as error:
            self._ready.put(error)
        else:
            self._ready.put(None)
        finally:
            if isinstance(self._items, Generator):
                self._items.close()  # in this thread, not in the garbage collector's

    def _wait_for_room(self) -> bool:
        """Wait until there is room for one more item; returns whether to go on."""
        try:
            self._room.get_nowait()
        except Empty:
            begin_s = time.monotonic()
            self._room.get()
            self.waited_s += time.monotonic() - begin_s
        return not self._stopping


def prefetched(function: Callable[[T], Result], items: Iterable[T], threads: int) -> Iterator[Result]:
    """Yield a function's result for each item, in order, computed in a number of threads, one item ahead in each.

    An exception is raised in the place of its result; nothing is begun after it.
    """
    pending: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(threads, thread_name_prefix="ahead") as pool:
        try:
            for item in items:
                pending.append(pool.submit(function, item))
                if len(pending) > threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


@contextmanager
def in_background(work: Callable[P, object], most: int = 2) -> Iterator[Callable[P, None]]:
    """Run calls of `work` in one background thread, in order. The caller waits when `most` calls are pending.

    All are done when the context ends. An exception is raised by a later call, or at the end.
    """
    pending: deque[Future[object]] = deque()

    def begin(*arguments: P.args, **named: P.kwargs) -> None:
        while len(pending) >= most:
            pending.popleft().result()
        pending.append(pool.submit(work, *arguments, **named))

    with ThreadPoolExecutor(1, thread_name_prefix="background") as pool:
        try:
            yield begin
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        while pending:
            pending.popleft().result()


@contextmanager
def _punctual() -> Iterator[None]:
    usual_s = sys.getswitchinterval()
    sys.setswitchinterval(_PUNCTUAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(usual_s)
