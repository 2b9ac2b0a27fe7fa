"""Conversions on a real Dask cluster: a scheduler and two worker processes on loopback."""

import os
import pickle
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

import nimprep
from nimprep.conversion import distributed as cluster_module
from nimprep.conversion import worker as worker_module
from nimprep.conversion.plan import Job
from nimprep.errors import ClusterError, DecodeError
from tests.fakes import contents, write_gmrp
from tests.held import RECORD, held
from tests.processes import PATIENCE_S, Processes
from tests.readers.test_extra_values import write_folder

distributed = pytest.importorskip("distributed")

from tests.conversion.cluster import Cluster, wait_until  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

FRAMES, LENGTH = 40, 2


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Return a cluster of two workers; whatever a test does to it, two are left."""
    with Processes() as processes:
        cluster = Cluster(tmp_path_factory.mktemp("cluster"), processes)
        for _ in range(2):
            cluster.start_worker()
        with cluster.client(workers=2):
            pass
        yield cluster


@contextmanager
def meanwhile(task: Callable[[], None]) -> Iterator[None]:
    """Do something in a thread; what goes wrong there is an error at the end."""
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(task)
        yield
        future.result()


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gmrp(tmp_path_factory.mktemp("source") / "gmrp", frames=FRAMES, size=(240, 320))


@pytest.fixture(scope="module")
def local(source: Path) -> dict[str, bytes]:
    """Return the files of the store that a conversion without a cluster makes."""
    store = nimprep.convert(source, source.parent / "local.zarr", shard_length=LENGTH)
    return contents(store.path)


def test_planes_of_a_dataset_are_encoded_by_workers_too(cluster: Cluster, tmp_path: Path) -> None:
    description = write_folder(tmp_path / "raw")
    made = [
        contents(
            nimprep.convert(
                tmp_path / "raw",
                tmp_path / f"{name}.zarr",
                description=description,
                shard_length=LENGTH,
                scheduler=scheduler,
            ).path
        )
        for name, scheduler in (("here", None), ("there", cluster.address))
    ]
    assert made[0] == made[1]
    assert "thermal/c/1/0/0" in made[0]


def test_the_bytes_are_those_of_a_conversion_without_a_cluster(
    cluster: Cluster, source: Path, local: dict[str, bytes], tmp_path: Path
) -> None:
    frames = []

    def progress(step: str, total: int):  # type: ignore[no-untyped-def]
        frames.append(total)
        return lambda: frames.append(1)

    def openings() -> list[int]:
        with cluster.client() as client:
            found = client.run(lambda: worker_module._opened.cache_info().misses)
        return [found[address] for address in workers]

    with cluster.client() as client:
        workers = sorted(client.run(os.getpid))
    before = openings()
    with cluster.gate() as gate:

        def let_both_begin() -> None:
            try:
                gate.wait_for(workers)
            finally:
                gate.open()

        with meanwhile(let_both_begin):
            store = nimprep.convert(
                source,
                tmp_path / "s.zarr",
                shard_length=LENGTH,
                scheduler=cluster.address,
                progress=progress,
            )
    assert contents(store.path) == local
    assert frames == [FRAMES] + FRAMES * [1]
    # Each opened the source once, and nothing is left there of it.
    assert [after - there for after, there in zip(openings(), before, strict=True)] == [1, 1]
    wait_until(lambda: cluster.tasks() == 0)


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
    cluster: Cluster,
    source: Path,
    local: dict[str, bytes],
    tmp_path: Path,
    processes: Processes,
) -> None:
    worker = cluster.start_worker(processes)
    with cluster.client(workers=3) as client:
        numbers = client.run(os.getpid)
    [victim] = [address for address, number in numbers.items() if number == worker.pid]
    tasks = []
    with cluster.gate() as gate:

        def kill_at_work() -> None:
            try:
                gate.wait_for(numbers)
                tasks.append(cluster.tasks())
                worker.kill()
                worker.wait()
            finally:
                gate.open()

        with meanwhile(kill_at_work):
            store = nimprep.convert(
                source, tmp_path / "s.zarr", shard_length=LENGTH, scheduler=cluster.address
            )
    assert tasks[0] <= 7, "more than the job and two units per thread"
    assert contents(store.path) == local
    with cluster.client() as client:
        assert set(client.run(os.getpid)) == numbers.keys() - {victim}


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
    cluster: Cluster,
    source: Path,
    local: dict[str, bytes],
    tmp_path: Path,
    processes: Processes,
) -> None:
    options = ("--shard-length", LENGTH, "--scheduler", cluster.address)
    with held(processes, RECORD, "convert", *options, source, tmp_path / "s.zarr") as process:
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, errors
    assert errors.startswith("interrupted; ")
    assert errors.endswith("frames are kept: the same command goes on from them\n")
    assert len(errors.splitlines()) == 1
    wait_until(lambda: cluster.tasks() == 0)
    units = tmp_path / ".s.zarr.partial" / "journal" / "units"
    assert len(list(units.iterdir())) == 1

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
        from nimprep.conversion import encode

        def failing(*arguments: object) -> None:
            mend()
            try:
                raise OSError(116, "Stale file handle")
            except OSError as error:
                raise DecodeError("gone for a moment") from error

        failing.mended = encode.encode_frame  # type: ignore[attr-defined]
        encode.encode_frame = failing  # type: ignore[assignment]

    def mend() -> bool:
        from nimprep.conversion import encode

        there = encode.encode_frame
        encode.encode_frame = getattr(there, "mended", there)
        return encode.encode_frame is not there

    with cluster.client() as client:
        client.run(fail_once)
        try:
            there = nimprep.convert(source, tmp_path / "there.zarr", scheduler=cluster.address)
        finally:
            mended = client.run(mend)
        assert not all(mended.values()), "no worker has failed"
    here = nimprep.convert(source, tmp_path / "here.zarr")
    assert contents(there.path) == contents(here.path)


def test_a_task_that_outlives_its_conversion_does_not_write_into_the_next(
    cluster: Cluster, source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def encode_and_change(client: object, job: Job) -> None:
        with cluster.client() as worker:
            data = worker_module.packed(job, "run")

            def encode() -> tuple[str, bytes]:
                return worker.submit(worker_module.encode_unit_of, data, 0, pure=False).result()

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
    source: Path, tmp_path: Path, processes: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "LOOK_S", 0.2)
    lonely = Cluster(tmp_path, processes)
    with monkeypatch.context() as patch:
        patch.setattr(cluster_module, "PATIENCE_S", 0)
        with (
            pytest.warns(UserWarning, match="no workers, waiting 0 s for some"),
            pytest.raises(ClusterError, match="expected workers, found none for 0 s"),
        ):
            nimprep.convert(source, tmp_path / "s.zarr", scheduler=lonely.address)
    said = []

    def lose(message: str, **named: object) -> None:
        said.append(message)
        lonely.scheduler.kill()

    monkeypatch.setattr(cluster_module.warnings, "warn", lose)
    with pytest.raises(ClusterError, match="found the connection lost"):
        nimprep.convert(source, tmp_path / "s.zarr", scheduler=lonely.address)
    assert len(said) == 1
    assert "no workers, waiting 300 s for some" in said[0]


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
