"""A stand-in for the module ray: actors in this process, which work only while somebody waits, and die when told to."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any


class RayError(Exception):
    pass


class RayTaskError(RayError):
    def __init__(self, cause: Exception) -> None:
        super().__init__(f"Traceback (most recent call last):\n{cause!r}")
        self.cause = cause


class Reference:
    def __init__(self, actor: FakeActor, call: Callable[[Any], Any], job: Any) -> None:
        self.actor, self.call, self.job = actor, call, job
        self.done, self.result, self.error = False, None, None

    def settle(self, result: Any = None, error: Exception | None = None) -> None:
        self.done, self.result, self.error = True, result, error


class FakeActor:
    def __init__(self, ray: FakeRay, make: Callable[[], Any]) -> None:
        self.ray, self.make, self.instance, self.alive = ray, make, None, True
        self.calls: list[Reference] = []

    def __getattr__(self, method: str) -> Any:
        def remote(*arguments: Any) -> Reference:
            job = arguments[0] if method == "do" else None
            reference = Reference(self, lambda instance: getattr(instance, method)(*arguments), job)
            if method == "ask" and self.alive:  # in another thread
                reference.settle(reference.call(self.instance))
            elif self.alive:
                self.calls.append(reference)
            else:
                reference.settle(error=RayError("the actor is dead"))
            return reference

        return SimpleNamespace(remote=remote)

    def die(self) -> None:
        self.alive = False
        for reference in self.calls:
            reference.settle(error=RayError("the actor died"))
        self.calls.clear()

    def work(self) -> None:
        """Do the oldest thing that was asked for."""
        if not self.calls or self.calls[0].job in self.ray.hanging:
            return
        if self.calls[0].job is not None and self.calls[0].job in self.ray.deadly:
            self.ray.died_at.append(self.calls[0].job)
            return self.die()
        self.instance = self.instance or self.make()
        reference = self.calls.pop(0)
        try:
            reference.settle(reference.call(self.instance))
        except Exception as error:  # noqa: BLE001 - whatever a worker raises
            reference.settle(error=RayTaskError(error))


class FakeRay:
    """The module ray, connected to a cluster.

    Attributes:
        deadly: Jobs that take their actor down.
        hanging: Jobs that never end.
        died_at: The jobs at which actors died.
        actors: All actors that were ever started.
        broken: Whether no actor comes up.
    """

    exceptions = SimpleNamespace(RayError=RayError, RayTaskError=RayTaskError)

    def __init__(self, cores: int = 2, *, deadly: Iterable[Any] = (), hanging: Iterable[Any] = ()) -> None:
        self.cores, self.deadly, self.hanging = cores, set(deadly), set(hanging)
        self.died_at: list[Any] = []
        self.actors: list[FakeActor] = []
        self.broken = False

    def is_initialized(self) -> bool:
        return True

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": float(self.cores)}

    def remote(self, **options: Any) -> Callable[[type], Any]:
        def decorate(actor_class: type) -> Any:
            return SimpleNamespace(remote=lambda *arguments: self._actor(lambda: actor_class(*arguments)))

        return decorate

    def _actor(self, make: Callable[[], Any]) -> FakeActor:
        self.actors.append(FakeActor(self, make))
        if self.broken:
            self.actors[-1].die()
        return self.actors[-1]

    def wait(self, references: list[Reference], *, num_returns: int, timeout: float) -> tuple[list[Reference], Any]:
        assert len(set(references)) == len(references) >= num_returns > 0
        if timeout and not any(reference.done for reference in references):
            for actor in self.actors:
                actor.work()
        done = [reference for reference in references if reference.done][:num_returns]
        return done, [reference for reference in references if reference not in done]

    def get(self, reference: Reference) -> Any:
        assert reference.done
        if reference.error is not None:
            raise reference.error
        return reference.result

    def kill(self, actor: FakeActor) -> None:
        actor.die()
