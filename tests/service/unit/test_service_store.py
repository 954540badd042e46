"""The store: one test a transition, and what must not happen."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from raykiln_service.database import Database, has_wal_reset_bug
from raykiln_service.errors import (
    ConflictError,
    IdempotencyMismatchError,
    LeaseLostError,
    NotFoundError,
    QueueFullError,
    StartupError,
)
from raykiln_service.jobs import Job, JobSpec, JobState, Lease
from raykiln_service.leases import MAX_STALLS, LeaseWatch
from raykiln_service.rows import StateEvent
from raykiln_service.store import IDEMPOTENCY_MS, Store
from raykiln_service.tables import metadata

SPEC = JobSpec({"name": "cornell_box"}, {"spp": 4})
RESULT = {"dir": "result-x", "files": []}
ERROR = {"reason": "crashed", "detail": "it broke"}


def add(store: Store, job_id: str = "job-1", **changes: object) -> Job:
    spec = JobSpec(**{"scene": {"name": "cornell_box"}, "settings": {}, **changes})  # type: ignore[arg-type]
    return store.create_job(job_id, spec)[0]


def claim(store: Store) -> Lease:
    job = store.claim("me", 30.0)
    assert job is not None
    assert job.lease is not None
    return job.lease


# One test a transition.


def test_a_new_job_is_queued_as_asked(store: Store) -> None:
    job, created = store.create_job("job-1", SPEC, max_attempts=5)
    assert created
    assert (job.state, job.spec, job.max_attempts) == (JobState.QUEUED, SPEC, 5)


def test_claim(store: Store) -> None:
    add(store)
    job = store.claim("me", 30.0)
    assert job is not None
    assert (job.state, job.attempts, job.started_ms) == (JobState.RUNNING, 1, 1_000_000)
    assert store.claim("me", 30.0) is None


def test_succeed(store: Store, clock: object) -> None:
    add(store)
    assert store.succeed(claim(store), RESULT) is JobState.SUCCEEDED
    job = store.job("job-1")
    assert (job.result, job.lease, job.finished_ms) == (RESULT, None, 1_000_000)


def test_fail(store: Store) -> None:
    add(store)
    assert store.fail(claim(store), ERROR) is JobState.FAILED
    assert store.job("job-1").error == ERROR


def test_cancel_of_a_queued_job_ends_it_now(store: Store) -> None:
    add(store)
    assert store.cancel("job-1").state is JobState.CANCELLED
    assert store.claim("me", 30.0) is None


def test_cancel_of_a_running_job_asks_first(store: Store) -> None:
    add(store)
    lease = claim(store)
    job = store.cancel("job-1")
    assert (job.state, job.cancel_requested) == (JobState.RUNNING, True)
    assert store.end_cancelled(lease, RESULT) is JobState.CANCELLED
    assert store.job("job-1").result == RESULT


def test_lose_puts_the_job_back(store: Store) -> None:
    add(store)
    assert store.lose(claim(store), ERROR, own_fault=True) is JobState.QUEUED
    job = store.job("job-1")
    assert (job.failures, job.interruptions, job.error, job.lease) == (1, 0, None, None)
    assert claim(store).attempt == 2


@pytest.mark.parametrize("ended", ["failed", "cancelled"])
def test_retry(store: Store, ended: str) -> None:
    add(store)
    lease = claim(store)
    if ended == "failed":
        store.fail(lease, ERROR)
    else:
        store.end_cancelled(lease, RESULT)
    job = store.retry("job-1")
    assert (job.state, job.error, job.result, job.finished_ms) == (
        JobState.QUEUED,
        None,
        None,
        None,
    )
    assert claim(store).attempt == 2


# What must not happen.


def test_no_retry_of_what_went_well(store: Store) -> None:
    add(store)
    store.succeed(claim(store), RESULT)
    with pytest.raises(ConflictError, match="succeeded cannot retry"):
        store.retry("job-1")


def test_no_cancel_of_what_has_ended(store: Store) -> None:
    add(store)
    store.succeed(claim(store), RESULT)
    with pytest.raises(ConflictError):
        store.cancel("job-1")


def test_cancel_twice_is_cancel(store: Store) -> None:
    add(store)
    store.cancel("job-1")
    assert store.cancel("job-1").state is JobState.CANCELLED


@pytest.mark.parametrize("end", ["succeed", "fail", "lose"])
def test_an_accepted_cancel_wins_over_every_other_end(store: Store, end: str) -> None:
    add(store)
    lease = claim(store)
    store.cancel("job-1")
    ends: dict[str, Callable[[], object]] = {
        "succeed": lambda: store.succeed(lease, RESULT),
        "fail": lambda: store.fail(lease, ERROR),
        "lose": lambda: store.lose(lease, ERROR, own_fault=True),
    }
    ends[end]()
    assert store.job("job-1").state is JobState.CANCELLED


@pytest.mark.parametrize("call", ["succeed", "fail", "lose", "heartbeat", "release", "cancelled"])
def test_a_lost_lease_changes_nothing(store: Store, call: str) -> None:
    add(store)
    old = claim(store)
    store.release(old)
    claim(store)
    before = store.job("job-1")
    calls: dict[str, Callable[[], object]] = {
        "succeed": lambda: store.succeed(old, RESULT),
        "fail": lambda: store.fail(old, ERROR),
        "lose": lambda: store.lose(old, ERROR, own_fault=True),
        "heartbeat": lambda: store.heartbeat(old, 30.0, None, advanced=True),
        "release": lambda: store.release(old),
        "cancelled": lambda: store.end_cancelled(old, RESULT),
    }
    with pytest.raises(LeaseLostError):
        calls[call]()
    assert store.job("job-1") == before


def test_a_job_fails_when_its_attempts_are_used_up(store: Store, clock: object) -> None:
    store.create_job("job-1", SPEC, max_attempts=2)
    assert store.lose(claim(store), ERROR, own_fault=True) is JobState.QUEUED
    assert store.lose(claim(store), ERROR, own_fault=True) is JobState.FAILED
    assert store.job("job-1").error == ERROR


def test_interruptions_do_not_use_up_attempts(store: Store) -> None:
    store.create_job("job-1", SPEC, max_attempts=1)
    for _ in range(5):
        assert store.lose(claim(store), ERROR, own_fault=False) is JobState.QUEUED
    job = store.job("job-1")
    assert (job.failures, job.interruptions, job.stalls) == (0, 5, 5)


def test_a_finished_pass_starts_the_count_of_stalls_anew(store: Store) -> None:
    add(store)
    store.lose(claim(store), ERROR, own_fault=False)
    lease = claim(store)
    store.heartbeat(lease, 30.0, {"spp_done": 4}, advanced=True)
    assert store.job("job-1").stalls == 0
    assert store.job("job-1").progress == {"spp_done": 4}


def test_a_job_that_always_takes_the_service_down_ends(store: Store) -> None:
    add(store)
    states = [store.lose(claim(store), ERROR, own_fault=False) for _ in range(MAX_STALLS)]
    assert states[-1] is JobState.FAILED
    assert set(states[:-1]) == {JobState.QUEUED}


def test_back_off(store: Store, clock: object) -> None:
    add(store)
    store.lose(claim(store), ERROR, own_fault=True, delay_s=2.0)
    assert store.claim("me", 30.0) is None
    clock.ms += 2000  # type: ignore[attr-defined]
    assert store.claim("me", 30.0) is not None


def test_leases_of_an_earlier_service_are_void(store: Store) -> None:
    add(store)
    old = claim(store)
    assert store.leases_of_others("me") == {}
    assert [*store.leases_of_others("other")] == [old]
    assert store.void(old)
    assert not store.void(old)
    assert store.job("job-1").interruptions == 1
    with pytest.raises(LeaseLostError):
        store.succeed(old, RESULT)


def test_a_silent_owner_loses_its_job_and_a_beating_one_keeps_it(store: Store, clock: Any) -> None:
    add(store)
    lease = claim(store)
    steady = [0.0]
    watch = LeaseWatch(store, 30.0, steady_s=lambda: steady[0])
    for _ in range(5):
        # The wall clock jumps as it likes; the beats are what counts.
        clock.ms += 7_200_000
        store.heartbeat(lease, 30.0, None, advanced=False)
        clock.ms -= 3_600_000
        assert watch.sweep("other") == []
        steady[0] += 20
    steady[0] += 5
    assert watch.sweep("other") == []
    steady[0] += 25.1
    assert watch.sweep("other") == ["job-1"]
    assert store.job("job-1").state is JobState.QUEUED


def test_a_cancelled_job_stays_cancelled_when_the_service_went_away(store: Store) -> None:
    add(store)
    lease = claim(store)
    store.cancel("job-1")
    store.void(lease)
    assert store.job("job-1").state is JobState.CANCELLED


# Half-way: the database must say no to what the code must never do.


@pytest.mark.parametrize(
    "broken",
    [
        "state = 'running'",
        "state = 'succeeded', finished_ms = 1",
        "state = 'failed', finished_ms = 1",
        "state = 'cancelled'",
        "state = 'paused'",
        "lease_token = 'x'",
        "error = '{}'",
        "attempts = -1",
        "cancel_requested = 2",
    ],
)
def test_the_database_refuses_a_row_that_contradicts_itself(store: Store, broken: str) -> None:
    add(store)
    with pytest.raises(sa.exc.IntegrityError), store.database.write() as connection:
        connection.execute(sa.text(f"UPDATE jobs SET {broken}"))
    assert store.job("job-1").state is JobState.QUEUED


def test_a_transaction_that_breaks_leaves_nothing(store: Store) -> None:
    heard: list[StateEvent] = []
    store.listen(heard.append)
    add(store)
    heard.clear()
    with pytest.raises(sa.exc.IntegrityError):
        add(store)
    assert heard == []
    assert len(store.events_after("job-1", 0)) == 1


def test_readers_cannot_write(sqlite_store: Store) -> None:
    with pytest.raises(sa.exc.OperationalError), sqlite_store.database.read() as connection:
        connection.execute(sa.text("DELETE FROM jobs"))


# Looking.


def test_higher_priority_goes_first_then_age(store: Store) -> None:
    for name, priority in (("a", 0), ("b", 5), ("c", 5), ("d", -1)):
        add(store, name, priority=priority)
    found = [store.job(name) for name in "abcd"]
    assert store.queue_positions(found) == {"b": 0, "c": 1, "a": 2, "d": 3}
    for job in found:
        assert store.queue_positions([job])[job.id] == store.queue_positions(found)[job.id]
    order = []
    while (claimed := store.claim("me", 30.0)) is not None:
        order.append(claimed.id)
    assert order == ["b", "c", "a", "d"]
    assert store.queue_positions([store.job("a")]) == {}


def test_pages_are_newest_first_and_lose_nothing_when_jobs_come(store: Store) -> None:
    for i in range(5):
        add(store, f"job-{i}")
    first = store.list_jobs(limit=2)
    add(store, "job-5")
    second = store.list_jobs(limit=10, before_seq=first[-1].seq)
    assert [job.id for job in first + second] == ["job-4", "job-3", "job-2", "job-1", "job-0"]


def test_filters(store: Store) -> None:
    add(store, "a", labels={"shot": "010", "by": "me"})
    add(store, "b", labels={"shot": "020"})
    claim(store)
    assert [j.id for j in store.list_jobs(labels={"shot": "010"})] == ["a"]
    assert [j.id for j in store.list_jobs(labels={"shot": None})] == ["b", "a"]
    assert [j.id for j in store.list_jobs(labels={"shot": None, "by": "me"})] == ["a"]
    assert [j.id for j in store.list_jobs(states=[JobState.QUEUED])] == ["b"]
    assert store.count_by_state()[JobState.RUNNING] == 1


def test_events_tell_the_whole_story_in_order(store: Store) -> None:
    heard: list[StateEvent] = []
    store.listen(heard.append)
    add(store)
    store.succeed(claim(store), RESULT)
    events = store.events_after("job-1", 0)
    assert [event.data["state"] for event in events] == ["queued", "running", "succeeded"]
    assert [event.seq for event in heard] == [event.seq for event in events]
    assert store.events_after("job-1", events[1].seq) == events[2:]


def test_delete(store: Store) -> None:
    add(store, labels={"a": "b"})
    with pytest.raises(ConflictError, match="cancel it first"):
        store.delete("job-1")
    store.cancel("job-1")
    store.delete("job-1")
    for call in (store.job, store.delete, store.cancel, store.retry):
        with pytest.raises(NotFoundError):
            call("job-1")
    assert store.events_after("job-1", 0) == []


# Submitting.


def test_the_same_key_gives_the_same_job(store: Store, clock: object) -> None:
    first, _ = store.create_job("job-1", SPEC, key="k", digest="d")
    again, created = store.create_job("job-2", SPEC, key="k", digest="d")
    assert (again.id, created) == (first.id, False)
    with pytest.raises(IdempotencyMismatchError):
        store.create_job("job-3", SPEC, key="k", digest="other")
    clock.ms += IDEMPOTENCY_MS + 1  # type: ignore[attr-defined]
    assert store.replayed("k", "d") is None
    assert store.create_job("job-4", SPEC, key="k", digest="other")[1]


def test_a_full_queue(store: Store) -> None:
    store.create_job("job-1", SPEC, max_queued=1)
    with pytest.raises(QueueFullError) as caught:
        store.create_job("job-2", SPEC, max_queued=1)
    assert caught.value.headers["Retry-After"]
    claim(store)
    assert store.create_job("job-3", SPEC, max_queued=1)[1]


def test_assets_are_noted_once(store: Store, clock: object) -> None:
    store.add_asset("sha256:1", 5, "a.glb")
    clock.ms += 1  # type: ignore[attr-defined]
    assert store.add_asset("sha256:1", 5, None).filename == "a.glb"
    again = store.add_asset("sha256:1", 5, "b.glb")
    assert (again.filename, again.created_ms) == ("b.glb", 1_000_000)
    with pytest.raises(NotFoundError):
        store.asset("sha256:2")


# The database itself.


def test_the_migrations_make_the_tables_of_the_code(sqlite_store: Store) -> None:
    declared = sa.create_engine("sqlite://")
    metadata.create_all(declared)
    with declared.connect() as connection:
        wanted = _schema(connection)
    declared.dispose()
    with sqlite_store.database.read() as connection:
        found = _schema(connection)
    del found["alembic_version"]
    assert found == wanted


def _schema(connection: sa.Connection) -> dict[str, object]:
    # The order of columns and constraints is of no matter: migrations add at the end.
    rows = connection.exec_driver_sql("SELECT type, name, sql FROM sqlite_master WHERE sql <> ''")
    found: dict[str, object] = {}
    for kind, name, sql in rows.all():
        if kind == "table":
            columns = connection.exec_driver_sql(f"PRAGMA table_xinfo({name})").all()
            keys = connection.exec_driver_sql(f"PRAGMA foreign_key_list({name})").all()
            found[name] = (
                {column[1:] for column in columns},
                {key[2:] for key in keys},
                sorted(re.findall(r"CHECK \(.*\)|UNIQUE \(.*?\)", sql)),
                [word in sql for word in ("STRICT", "AUTOINCREMENT")],
            )
        else:
            found[name] = re.sub(r"\s+", " ", sql)
    return found


def test_the_queue_is_read_in_the_order_of_its_index(sqlite_store: Store) -> None:
    asked: list[str] = []

    def note(*arguments: Any) -> None:
        asked.append(arguments[2])

    add(sqlite_store)
    sa.event.listen(sa.Engine, "before_cursor_execute", note)
    sqlite_store.claim("me", 30.0)
    sa.event.remove(sa.Engine, "before_cursor_execute", note)
    query = next(sql for sql in asked if "LIMIT" in sql and "not_before_ms" in sql)
    with sqlite_store.database.read() as connection:
        plan = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {query}", (0, 1, 1, 0)).all()
    text = " ".join(row[3] for row in plan)
    assert "ix_jobs_queue" in text
    assert "B-TREE" not in text


def plans_of(store: Store, look: Callable[[], object]) -> list[str]:
    """How SQLite carries out what `look` asks, a line for each step."""
    asked: list[tuple[str, Any]] = []

    def note(_connection: Any, _cursor: Any, sql: str, values: Any, *_rest: Any) -> None:
        asked.append((sql, values))

    sa.event.listen(sa.Engine, "before_cursor_execute", note)
    look()
    sa.event.remove(sa.Engine, "before_cursor_execute", note)
    steps = []
    with store.database.read() as connection:
        for sql, values in asked:
            if sql.startswith("SELECT"):
                plan = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {sql}", values)
                steps += [str(row[3]) for row in plan]
    assert steps
    return steps


_BOTH = (JobState.QUEUED, JobState.FAILED)


@pytest.mark.parametrize(
    "asked",
    [
        {"states": [JobState.QUEUED]},
        {"states": [JobState.QUEUED], "before_seq": 5000},
        {"states": _BOTH, "before_seq": 5000},
        {"owner": "tok-1"},
        {"owner": "tok-1", "states": _BOTH, "before_seq": 5000},
    ],
)
def test_a_page_of_jobs_is_read_in_the_order_of_an_index(
    sqlite_store: Store, asked: dict[str, Any]
) -> None:
    steps = plans_of(sqlite_store, lambda: sqlite_store.list_jobs(**asked))
    pages = [step for step in steps if " jobs " in f"{step} "]
    assert pages
    for step in pages:
        assert step.startswith("SEARCH jobs USING INDEX ix_jobs_"), steps
    for before, step in pairwise(steps):
        # Only the few that the parts have found are put in order.
        assert "TEMP B-TREE" not in step or before.startswith("SCAN anon_"), steps


@pytest.mark.parametrize("labels", [{"a": "1"}, {"a": None}, {"a": "1", "b": "2"}])
@pytest.mark.parametrize("states", [(), [JobState.QUEUED], _BOTH])
def test_labels_are_looked_up(sqlite_store: Store, labels: dict[str, Any], states: Any) -> None:
    look = lambda: sqlite_store.list_jobs(labels=labels, states=states)  # noqa: E731
    steps = plans_of(sqlite_store, look)
    found = [step for step in steps if "job_labels" in step]
    assert found
    assert all(step.startswith("SEARCH job_labels USING ") for step in found), steps
    assert not any(step.startswith("SCAN jobs") for step in steps), steps


def test_the_queue_and_a_job_in_it_are_looked_up(sqlite_store: Store) -> None:
    add(sqlite_store)
    job = sqlite_store.job("job-1")
    looks: list[Callable[[], object]] = [
        sqlite_store.queue_now,
        sqlite_store.recent_runs,
        sqlite_store.oldest_queued_ms,
        lambda: sqlite_store.queue_positions([job]),
        lambda: sqlite_store.queue_positions([job, job]),
        lambda: sqlite_store.events_after("job-1", 0),
        lambda: sqlite_store.frame_counts(["job-1"]),
        lambda: sqlite_store.leases_of("me"),
    ]
    for look in looks:
        for step in plans_of(sqlite_store, look):
            assert not step.startswith(("SCAN jobs", "SCAN events", "SCAN frames")), step


def test_pages_of_several_states_and_owners(store: Store) -> None:
    for number in range(12):
        add(store, f"job-{number}")
        if number % 3 == 0:
            store.cancel(f"job-{number}")
    states = [JobState.CANCELLED, JobState.QUEUED, JobState.CANCELLED]
    first = store.list_jobs(states=states, limit=5)
    assert [job.id for job in first] == [f"job-{n}" for n in (11, 10, 9, 8, 7)]
    rest = store.list_jobs(states=states, limit=50, before_seq=first[-1].seq)
    assert [job.id for job in rest] == [f"job-{n}" for n in (6, 5, 4, 3, 2, 1, 0)]
    assert store.list_jobs(owner="tok-1") == []


def test_a_second_migration_changes_nothing(store: Store) -> None:
    add(store)
    store.database.migrate()
    assert store.job("job-1").state is JobState.QUEUED


def test_sqlite_is_set_up_to_lose_nothing(sqlite_store: Store) -> None:
    with sqlite_store.database.write() as connection:
        found = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys")
        }
        tables = connection.exec_driver_sql(
            "SELECT name, strict FROM pragma_table_list "
            "WHERE schema = 'main' AND name NOT LIKE 'sqlite%' AND name <> 'alembic_version'"
        ).all()
    assert found == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}
    assert {name for name, _strict in tables} == set(metadata.tables)
    assert all(strict for _name, strict in tables)


@pytest.mark.parametrize(
    ("version", "affected"),
    [
        ((3, 6, 23), False),
        ((3, 40, 1), True),
        ((3, 44, 5), True),
        ((3, 44, 6), False),
        ((3, 45, 0), True),
        ((3, 50, 6), True),
        ((3, 50, 7), False),
        ((3, 51, 2), True),
        ((3, 51, 3), False),
    ],
)
def test_which_sqlite_needs_one_writer(version: tuple[int, ...], affected: bool) -> None:
    assert has_wal_reset_bug(version) is affected


def test_a_file_that_is_no_database(tmp_path: Path) -> None:
    path = tmp_path / "x.db"
    path.write_text("this is no database, however long one looks at it\n" * 20)
    with pytest.raises(StartupError, match="not a database"):
        Database(Database.sqlite_url(path)).migrate()


@pytest.mark.parametrize("url", ["nonsense", "nosuch://x/y"])
def test_a_url_that_is_none(url: str) -> None:
    with pytest.raises(StartupError, match="URL"):
        Database(url)
