"""Work in threads of their own, with bounded queues: an iterator that runs on ahead, and what is done beside."""

import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Generic, ParamSpec, TypeVar

T = TypeVar("T")
P = ParamSpec("P")

_PUNCTUAL_S = 0.0005  # a thread that keeps time gets its turn so soon, whatever Python code others run


class Ahead(Generic[T]):
    """Items of an iterator, taken up to `most` ahead of who asks for them, from the first time on that somebody asks.

    What the iterator raises is raised in its turn. Can be walked through once; when that ends, or is ended, the
    iterator has stopped. `waited_s`: how long it stood still because nobody took what was there.
    """

    def __init__(self, items: Iterator[T], most: int) -> None:
        self._items = items
        # Both queues are C's: an interruption of the main thread leaves none of their locks taken.
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
                while (found := self._ready.get()) is not None:
                    if isinstance(found, BaseException):
                        raise found
                    yield found[0]
                    self._room.put(None)
            finally:
                self.stop()

    def stop(self) -> None:
        """Return when the iterator has stopped, however often that is interrupted: others are about to take away what
        it works with.
        """
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
            while self._wait_for_room() and (found := next(self._items, self)) is not self:
                self._ready.put((found,))  # type: ignore[arg-type]  # self stands for the end
        except BaseException as error:
            self._ready.put(error)
        else:
            self._ready.put(None)
        finally:
            if isinstance(self._items, Generator):
                self._items.close()  # here, not wherever it is collected

    def _wait_for_room(self) -> bool:
        """Whether to go on, when there is room for one more."""
        try:
            self._room.get_nowait()
        except Empty:
            begin_s = time.monotonic()
            self._room.get()
            self.waited_s += time.monotonic() - begin_s
        return not self._stopping


@contextmanager
def beside(work: Callable[P, object], most: int = 2) -> Iterator[Callable[P, None]]:
    """Call it in one thread, call after call, while the caller goes on; it waits where `most` calls are to be done.

    All are done when the context ends. What one raises is raised by a later one, or at the end.
    """
    pending: deque[Future[object]] = deque()

    def begin(*arguments: P.args, **named: P.kwargs) -> None:
        while len(pending) >= most:
            pending.popleft().result()
        pending.append(pool.submit(work, *arguments, **named))

    with ThreadPoolExecutor(1, thread_name_prefix="beside") as pool:
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
