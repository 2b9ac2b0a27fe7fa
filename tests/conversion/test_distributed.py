"""Conversions on a real Dask cluster: a scheduler and two worker processes on loopback."""

import contextlib
import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import nimprep
from nimprep.conversion import distributed as cluster_module
from nimprep.conversion.job import Job
from nimprep.errors import ClusterError, DecodeError
from tests.fakes import contents, write_gmrp

distributed = pytest.importorskip("distributed")

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

FRAMES, LENGTH = 40, 2


class Cluster:
    """A scheduler and its workers, each a process with one thread."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._processes: list[subprocess.Popen[bytes]] = []
        self.start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-show")
        file = folder / "scheduler.json"
        wait_until(lambda: file.exists() and bool(file.read_bytes().strip().endswith(b"}")))
        self.address = json.loads(file.read_text())["address"]

    def start(self, what: str, *arguments: str) -> subprocess.Popen[bytes]:
        file = str(self._folder / "scheduler.json")
        command = [sys.executable, "-m", "dask", what, "--scheduler-file", file, *arguments]
        with (self._folder / f"{what}-{len(self._processes)}.log").open("wb") as log:
            process = subprocess.Popen(
                [*command, "--no-dashboard"], stdout=log, stderr=log, cwd=self._folder
            )
        self._processes.append(process)
        return process

    def start_worker(self) -> subprocess.Popen[bytes]:
        return self.start("worker", "--nthreads", "1", "--no-nanny", "--host", "127.0.0.1")

    @contextlib.contextmanager
    def client(self) -> Iterator["distributed.Client"]:
        with distributed.Client(self.address, set_as_default=False) as client:
            yield client

    def close(self) -> None:
        for process in self._processes:
            process.kill()
            process.wait()


def wait_until(condition, seconds: float = 60) -> None:  # type: ignore[no-untyped-def]
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        for _ in range(2):
            cluster.start_worker()
        with cluster.client() as client:
            client.wait_for_workers(2, timeout=60)
        yield cluster
    finally:
        cluster.close()


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gmrp(tmp_path_factory.mktemp("source") / "gmrp", frames=FRAMES, size=(240, 320))


@pytest.fixture(scope="module")
def local(source: Path) -> dict[str, bytes]:
    """Return the files of the store that a conversion without a cluster makes."""
    store = nimprep.convert(source, source.parent / "local.zarr", shard_length=LENGTH)
    return contents(store.path)


def test_the_bytes_are_those_of_a_conversion_without_a_cluster(
    cluster: Cluster, source: Path, local: dict[str, bytes], tmp_path: Path
) -> None:
    frames = []

    def progress(step: str, total: int):  # type: ignore[no-untyped-def]
        frames.append(total)
        return lambda: frames.append(1)

    store = nimprep.convert(
        source,
        tmp_path / "s.zarr",
        shard_length=LENGTH,
        scheduler=cluster.address,
        progress=progress,
    )
    assert contents(store.path) == local
    assert frames == [FRAMES] + FRAMES * [1]
    with cluster.client() as client:
        # Both took part, each opened the source once, and nothing is left there of it.
        opened = client.run(lambda: cluster_module._opened.cache_info().misses)
        assert list(opened.values()) == [1, 1]
        assert client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)) == 0


def test_a_relative_source_and_camera_file_are_found_by_workers_elsewhere(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_gmrp(tmp_path / "gmrp", frames=3)
    camera = '{"fx": 30, "fy": 30, "cx": 16, "cy": 12, "width": 32, "height": 24}'
    (tmp_path / "camera.json").write_text(camera)
    monkeypatch.chdir(tmp_path)
    there = nimprep.convert("gmrp", "there.zarr", camera="camera.json", scheduler=cluster.address)
    here = nimprep.convert("gmrp", "here.zarr", camera="camera.json")
    assert contents(there.path) == contents(here.path)


def test_a_lost_workers_units_are_done_again(
    cluster: Cluster, source: Path, local: dict[str, bytes], tmp_path: Path
) -> None:
    lost: list[tuple[int, int]] = []

    def progress(step: str, total: int):  # type: ignore[no-untyped-def]
        def done() -> None:
            if lost:
                return
            with cluster.client() as client:
                tasks = client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))
                at_work = client.processing()
                victim = max(at_work, key=lambda address: len(at_work[address]))
                process = client.run(os.getpid, workers=[victim])[victim]
            os.kill(process, signal.SIGKILL)
            lost.append((tasks, len(at_work[victim])))

        return done

    store = nimprep.convert(
        source,
        tmp_path / "s.zarr",
        shard_length=LENGTH,
        scheduler=cluster.address,
        progress=progress,
    )
    assert lost[0][0] <= 5, "more than the job and two units per thread"
    assert lost[0][1] > 0, "the worker had nothing to do when it was killed"
    assert contents(store.path) == local
    cluster.start_worker()
    with cluster.client() as client:
        client.wait_for_workers(2, timeout=60)


def test_a_bad_frame_ends_it_at_once_and_is_named(cluster: Cluster, tmp_path: Path) -> None:
    source = write_gmrp(tmp_path / "gmrp", frames=7)
    options = {"shard_length": 2, "scheduler": cluster.address}
    bad = source / "label" / "000006.png"
    whole = bad.read_bytes()
    bad.write_bytes(whole[:-30])
    with pytest.raises(DecodeError, match=r"label/000006\.png: expected a whole PNG") as caught:
        nimprep.convert(source, tmp_path / "s.zarr", **options)
    assert caught.value.frame_id == "000006"
    skipped = nimprep.convert(source, tmp_path / "skipped.zarr", on_error="skip", **options)
    assert [frame["id"] for frame in skipped.attributes["skipped"]] == ["000006"]
    assert skipped.attributes["skipped"][0]["reason"].startswith("label/000006.png: expected")
    bad.write_bytes(whole)
    there = nimprep.convert(source, tmp_path / "s.zarr", **options)
    here = nimprep.convert(source, tmp_path / "here.zarr", shard_length=2)
    assert contents(there.path) == contents(here.path)


def test_ctrl_c_drops_what_is_left_and_the_same_command_goes_on(
    cluster: Cluster, source: Path, local: dict[str, bytes], tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "nimprep", "convert", str(source), str(tmp_path / "s.zarr")]
    command += ["--shard-length", str(LENGTH), "--scheduler", cluster.address]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    units = tmp_path / ".s.zarr.partial" / "journal" / "units"
    wait_until(lambda: list(units.glob("*.json")) or process.poll() is not None)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert errors.startswith("interrupted; ")
    assert errors.endswith("frames are kept: the same command goes on from them\n")
    assert len(errors.splitlines()) == 1
    with cluster.client() as client:
        assert client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)) == 0
    before = {path: path.stat().st_mtime_ns for path in units.iterdir()}
    assert 0 < len(before) < FRAMES // LENGTH

    def progress(step: str, total: int):  # type: ignore[no-untyped-def]
        assert step == "going on converting"
        return lambda: None

    store = nimprep.convert(
        source,
        tmp_path / "s.zarr",
        shard_length=LENGTH,
        scheduler=cluster.address,
        progress=progress,
    )
    assert contents(store.path) == local


def test_workers_of_another_version_are_refused(
    cluster: Cluster, source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "__version__", "9.9")
    words = r"expected nimprep 9\.9 on every worker, found nimprep .* on worker tcp://127"
    with pytest.raises(ClusterError, match=words):
        nimprep.convert(source, tmp_path / "s.zarr", scheduler=cluster.address)
    assert list(tmp_path.iterdir()) == []


def test_workers_without_nimprep_say_so(
    cluster: Cluster, source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forget() -> None:
        sys.modules["nimprep"] = None  # type: ignore[assignment]

    def remember() -> None:
        del sys.modules["nimprep"]

    with cluster.client() as client:
        client.run(forget)
        try:
            with pytest.raises(ClusterError, match=r"found import of nimprep halted.* on worker"):
                nimprep.convert(source, tmp_path / "s.zarr", scheduler=cluster.address)
        finally:
            client.run(remember)


def test_a_file_system_that_fails_for_a_moment_is_tried_again(
    cluster: Cluster, tmp_path: Path
) -> None:
    source = write_gmrp(tmp_path / "gmrp", frames=4)

    def fail_once() -> None:
        from nimprep.conversion import job

        def failing(*arguments: object) -> None:
            mend()
            try:
                raise OSError(116, "Stale file handle")
            except OSError as error:
                raise DecodeError("gone for a moment") from error

        job.encode_frame = failing  # type: ignore[assignment]

    def mend() -> bool:
        from nimprep.conversion import encode, job

        mended = job.encode_frame is not encode.encode_frame
        job.encode_frame = encode.encode_frame
        return mended

    with cluster.client() as client:
        client.run(fail_once)
        there = nimprep.convert(source, tmp_path / "there.zarr", scheduler=cluster.address)
        assert not all(client.run(mend).values()), "no worker has failed"
    here = nimprep.convert(source, tmp_path / "here.zarr")
    assert contents(there.path) == contents(here.path)


def test_a_task_that_outlives_its_conversion_does_not_write_into_the_next(
    cluster: Cluster, source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def encode_and_change(client: object, job: Job) -> None:
        with cluster.client() as worker:
            data = cluster_module._packed(job, "run")

            def encode() -> tuple[str, bytes]:
                return worker.submit(cluster_module.encode_unit_of, data, 0, pure=False).result()

            assert encode()[0] == "record"
            written = contents(tmp_path)
            job.storage.write("zarr.json", [b"of another conversion"])
            kind, error = encode()
        job.storage.remove("zarr.json")
        assert kind == "error"
        assert "expected the store being converted" in str(pickle.loads(error))
        shards = {name: data for name, data in written.items() if "/c/" in name}
        assert len(shards) == len(job.layout.modalities)
        assert contents(tmp_path).items() >= shards.items()
        raise KeyboardInterrupt

    monkeypatch.setattr(cluster_module, "_submitter", encode_and_change)
    with pytest.raises(KeyboardInterrupt):
        nimprep.convert(source, tmp_path / "s.zarr", scheduler=cluster.address)


def test_a_cluster_without_workers_or_gone_is_one_clear_error(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "LOOK_S", 0.2)
    lonely = Cluster(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(cluster_module, "PATIENCE_S", 0)
        with (
            pytest.warns(UserWarning, match="no workers, waiting 0 s for some"),
            pytest.raises(ClusterError, match="expected workers, found none for 0 s"),
        ):
            nimprep.convert(source, tmp_path / "s.zarr", scheduler=lonely.address)
    try:
        threading.Timer(1, lonely.close).start()
        with (
            pytest.warns(UserWarning, match="no workers, waiting 300 s for some"),
            pytest.raises(ClusterError, match="found the connection lost"),
        ):
            nimprep.convert(source, tmp_path / "s.zarr", scheduler=lonely.address)
    finally:
        lonely.close()


def test_a_unit_that_every_worker_is_lost_at_is_named() -> None:
    class Future:
        def result(self) -> None:
            raise distributed.KilledWorker("nimprep-unit-7", None, 3)

    with pytest.raises(ClusterError, match="unit 7: expected a worker to finish it, found the la"):
        cluster_module._record(Future(), 7)


@pytest.mark.parametrize("address", ["localhost", "http://127.0.0.1:80", "tcp://127.0.0.1:{free}"])
def test_a_scheduler_out_of_reach_is_one_clear_error(
    address: str, source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_S", 0.4)
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = address.format(free=unused.getsockname()[1])
        with pytest.raises(ClusterError, match=f"{address}: expected a Dask scheduler, found "):
            nimprep.convert(source, tmp_path / "s.zarr", scheduler=address)
    assert list(tmp_path.iterdir()) == []


def test_something_else_than_a_scheduler_is_left_after_a_while(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "CONNECT_S", 0.4)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        address = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        with pytest.raises(ClusterError, match="expected a Dask scheduler, found no answer"):
            nimprep.convert(source, tmp_path / "s.zarr", scheduler=address)


def test_without_dask_it_says_what_to_install(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ClusterError, match=r"pip install 'nimprep\[distributed\]'"):
        nimprep.convert(source, tmp_path / "s.zarr", scheduler="tcp://127.0.0.1:8786")


def test_dask_is_imported_by_nobody_else(source: Path, tmp_path: Path) -> None:
    program = (
        "import sys, nimprep; nimprep.convert(*sys.argv[1:]);"
        "sys.exit('dask' in sys.modules or 'distributed' in sys.modules)"
    )
    command = [sys.executable, "-W", "ignore", "-c", program, str(source), str(tmp_path / "s.zarr")]
    assert subprocess.run(command, check=False).returncode == 0
