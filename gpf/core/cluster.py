"""Connect to a Ray cluster, or start one on this machine, and collect its task results."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from gpf.core.errors import UserError

HEAD_TRIES = 5
"""Attempts, a second apart, to reach a head that does not answer: it may be restarting."""

AHEAD = 2
"""Tasks that a cluster has at a time, relative to those that it can run: some wait for a machine,
so that no machine waits for them."""

Task = TypeVar("Task")


@dataclass(frozen=True)
class ClusterChoice:
    """Which cluster to use, and how messages name the two options.

    Attributes
    ----------
    asked_by: the option that asks for Ray.
    address: address of a cluster, ``HOST:PORT``; empty to start one on this machine.
    address_option: the option that gives the address.
    cores: number of cores for a cluster started on this machine.
    """

    asked_by: str
    address: str
    address_option: str
    cores: int

    @classmethod
    def of_options(cls, executor: str, address: str) -> ClusterChoice | None:
        """The cluster that a command's ``--executor`` and ``--cluster`` ask for, or None.

        Raises
        ------
        UserError: there is an address, but the executor is not ``ray``.
        """
        if executor == "ray":
            return cls("--executor", address, "--cluster", os.cpu_count() or 1)
        if address:
            raise UserError("--cluster", "needs `--executor ray`", "Give both, or leave it out.")
        return None

    def connect(self) -> Any:
        """Connect, and return the module ``ray``.

        Raises
        ------
        UserError: Ray is not installed, or the address cannot be reached.
        """
        try:
            import ray
        except ImportError as error:
            raise UserError(
                self.asked_by,
                "is ray, but the ray package is not installed",
                "Install it (`pip install ray`), or choose local.",
            ) from error
        if ray.is_initialized():
            return ray
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        # New workers import this package from the same place as this process.
        root = str(Path(__file__).resolve().parents[2])
        paths = [root, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
        options: dict[str, Any] = {"log_to_driver": False, "configure_logging": False}
        if self.address:
            self._require_listener()
            options["address"] = self.address
        else:
            options |= {
                "num_cpus": self.cores,
                "include_dashboard": False,
                "runtime_env": {"env_vars": {"PYTHONPATH": os.pathsep.join(paths)}},
            }
        try:
            ray.init(**options)
        except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
            raise self._unreachable(error) from error
        return ray

    def _require_listener(self) -> None:
        """Check that something listens at the address; Ray itself would keep trying for minutes."""
        host, _, port = self.address.removeprefix("ray://").rpartition(":")
        if host and port.isdecimal():
            try:
                socket.create_connection((host, int(port)), timeout=5).close()
            except OSError as error:
                raise self._unreachable(error) from error

    def _unreachable(self, error: Exception) -> UserError:
        return UserError(
            f"{self.address_option}: {self.address!r}",
            f"cannot be reached ({str(error).splitlines()[0]})",
            "Start a cluster with `ray start --head`, or leave the address empty.",
        )


def cores_of_smallest_machine(ray: Any) -> float:
    """Cores that a task must reserve to have a machine to itself: no machine has fewer."""
    return min(_cores_of_machines(ray), default=1.0)


def tasks_at_once(ray: Any, cores: float) -> int:
    """How many tasks that reserve this many cores run at the same time."""
    return max(1, sum(int(own // cores) for own in _cores_of_machines(ray)))


def _cores_of_machines(ray: Any) -> list[float]:
    """The cores of each machine that runs tasks; a head may have none."""
    cores = [float(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
    return [own for own in cores if own > 0]


def run_tasks(
    ray: Any, cores: float, tasks: Iterable[tuple[Task, Any]]
) -> Iterator[tuple[Task, Any]]:
    """The results of tasks, in the order in which they arrive.

    Parameters
    ----------
    cores: those that each task reserves.
    tasks: what each is, which ``str`` names in messages, and its reference, or the generator of the
        references of several results. Only :data:`AHEAD` times as many are taken as can run, so
        that the data of the others need no memory yet.

    Raises
    ------
    UserError: as :func:`wait_for_tasks` and :func:`task_result`.
    """
    running: dict[Any, Task] = {}
    rest, most = iter(tasks), AHEAD * tasks_at_once(ray, cores)
    try:
        while True:
            for task, reference in islice(rest, most - len(running)):
                running[reference] = task
            if not running:
                return
            for reference in wait_for_tasks(ray, running):
                task, result = running.pop(reference), reference
                if isinstance(reference, ray.ObjectRefGenerator):
                    if (result := next(reference, None)) is None:  # it has ended
                        continue
                    running[reference] = task
                yield task, task_result(ray, result, str(task))
    finally:
        for reference in running:
            ray.cancel(reference, force=True)


def wait_for_tasks(ray: Any, running: Collection[Any]) -> list[Any]:
    """The tasks that have finished; empty if none finishes within a second.

    Raises
    ------
    UserError: the cluster is lost, see `_require_cluster`.
    """
    _require_cluster(ray)
    ready, _ = ray.wait(list(running), timeout=1.0)
    return list(ready)


def _require_cluster(ray: Any) -> None:
    """Check that the head and this machine's node are alive. Without them, Ray silently kills this
    process, either as soon as it needs them or a minute later."""
    _require_head(ray.get_runtime_context().gcs_address)
    _require_own_node(ray)


def _require_head(address: str) -> None:
    host, _, port = address.rpartition(":")
    for _ in range(HEAD_TRIES):
        if _listens(host.strip("[]"), int(port)):
            return
        time.sleep(1)
    raise _lost(f"the head of the Ray cluster, {address}")


def _require_own_node(ray: Any) -> None:
    own = ray.get_runtime_context().get_node_id()
    for node in ray.nodes():
        host, port = node["NodeManagerAddress"], node["NodeManagerPort"]
        if node["NodeID"] == own and not _listens(host, port):
            raise _lost(f"this machine's node of the Ray cluster, {host}:{port}")


def _listens(host: str, port: int) -> bool:
    try:
        socket.create_connection((host, port), timeout=5).close()
    except OSError:
        return False
    return True


def _lost(what: str) -> UserError:
    return UserError(
        what,
        "no longer answers",
        "Restart the cluster, then run this again: finished work is saved.",
    )


def task_result(ray: Any, reference: Any, what: str) -> Any:
    """The result of a task; ``what`` names it in messages.

    Raises
    ------
    UserError: the task raised it, its worker was lost more often than Ray retries, or the
        cluster is lost, see `_require_cluster`.
    """
    _require_cluster(ray)
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        cause = error.cause
        if isinstance(cause, UserError):
            raise UserError(cause.where, cause.what, cause.todo) from error
        raise
    except ray.exceptions.RayError as error:
        raise UserError(
            what,
            "was lost, and so were all retries",
            "Check the memory of the workers; the results of other tasks are saved.",
        ) from error
