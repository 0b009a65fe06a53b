"""Checkpoints: what is resumed is the uninterrupted search to the bit, or is clearly refused."""

import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
from es_problems import SETTINGS, TWO_STAGES, distance_squared, same_result, space

import es
from es import checkpoint_files
from es.search import describe

HERE = Path(__file__).parent
SHORTEST_GENERATION = 0.03  # s, so that a signal strikes whatever the speed of the machine


def run(folder: Path | None = None, evaluate=distance_squared, settings=SETTINGS, seed=0, notices=None, **identity):
    checkpointer = None
    if folder is not None:
        notify = [].append if notices is None else notices.append
        checkpointer = es.Checkpointer(folder, identity, seconds_between=0.0, notify=notify)
    return es.search(evaluate, space(), TWO_STAGES, settings, jax.random.key(seed), checkpointer=checkpointer)


def interrupted_at(generation: int):
    """The cost, but Ctrl-C in the evaluation of this generation (the first is 1)."""
    calls = []

    def evaluate(stage, x, key):
        calls.append(0)
        if len(calls) == generation:
            raise KeyboardInterrupt
        return distance_squared(stage, x, key)

    return evaluate


@pytest.fixture(scope="module")
def uninterrupted() -> es.SearchResult:
    return run()


@pytest.fixture(scope="module")
def stopped(tmp_path_factory) -> Path:
    """Folder of a search that was stopped in its second stage, after generation 8 of 12; copy it before use."""
    folder = tmp_path_factory.mktemp("stopped") / "checkpoints"
    with pytest.raises(
        es.SearchInterrupted, match=r"after 8 of at most 12 generations; the checkpoint in .* continues"
    ):
        run(folder, interrupted_at(9), task="jump")
    return folder


@pytest.fixture
def folder(stopped: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(stopped, tmp_path / "checkpoints"))


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# before, at and after the change of stage
@pytest.mark.parametrize("generation", [2, 6, 7, 12])
def test_a_resumed_search_is_the_uninterrupted_one_to_the_bit(tmp_path, uninterrupted, generation):
    with pytest.raises(es.SearchInterrupted):
        run(tmp_path, interrupted_at(generation))
    found = run(tmp_path)
    assert found.resumed_at == generation - 1
    assert same_result(found, uninterrupted)
    again = run(tmp_path, evaluate=interrupted_at(1))  # finished: nothing is evaluated any more
    assert again.resumed_at == 12 and same_result(again, uninterrupted)


def test_the_last_three_are_kept(folder):
    assert names(folder) == [f"generation_{i:08d}" for i in (6, 7, 8)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"task": "trot"}, ['identity.task is "jump" there and "trot" here']),
        ({"task": "jump", "model": "a1"}, ['identity.model is missing there and "a1" here']),
        ({"task": "jump", "seed": 1}, ["search.key is [0, 0] there and [0, 1] here"]),
        (
            {"task": "jump", "settings": es.SearchSettings(population=16)},
            ["search.settings.population is 12 there and 16 here"],
        ),
    ],
)
def test_another_search_is_refused_and_its_checkpoints_are_left_alone(folder, change, words):
    before = names(folder)
    with pytest.raises(es.CheckpointError) as refusal:
        run(folder, **change)
    assert all(word in str(refusal.value) for word in [*words, "generation_00000008"]), refusal.value
    assert "\n" not in str(refusal.value) and names(folder) == before


def damage(path: Path, rng: np.random.Generator) -> str:
    """Tear, overwrite, extend or delete a file as a crash or a disk would; says how."""
    content = path.read_bytes()
    kind = rng.choice(["torn", "zeroed", "flipped", "longer", "gone"])
    at = int(rng.integers(len(content))) if content else 0
    if kind == "torn":
        path.write_bytes(content[:at])
    elif kind == "zeroed":
        path.write_bytes(content[:at] + bytes(len(content) - at))
    elif kind == "flipped":
        path.write_bytes(content[:at] + bytes([content[at] ^ (1 << int(rng.integers(8)))]) + content[at + 1 :])
    elif kind == "longer":
        path.write_bytes(content + rng.bytes(7))
    else:
        path.unlink()
    return str(kind)


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file() and path.stat().st_size > 0)


def damage_and_load(stopped: Path, work: Path, seed: int) -> int | None:
    """Damage 1 to 3 files, load, and compare; which generation was loaded, None if it was refused."""
    rng = np.random.default_rng(seed)
    folder = Path(shutil.copytree(stopped, work / f"damaged_{seed}"))
    hit = rng.choice(files(folder), size=int(rng.integers(1, 4)), replace=False)
    for path in hit:
        damage(path, rng)
    notices = []
    fingerprint = json.loads((stopped / "generation_00000008" / "manifest.json").read_text())["fingerprint"]
    checkpointer = es.Checkpointer(folder, fingerprint["identity"], notify=notices.append)
    checkpointer.open(fingerprint["search"])
    damaged = {path.relative_to(folder).parts[0] for path in hit}
    whole = [name for name in names(stopped) if name not in damaged]
    try:
        loaded = checkpointer.load()
    except es.CheckpointError as refusal:
        assert not whole, f"a whole checkpoint was refused: {refusal}"
        assert all(name in str(refusal) for name in damaged)
        return None
    assert whole, f"nothing was whole, but seed {seed} loaded"
    expected = checkpoint_files.read_arrays(stopped / whole[-1])
    assert loaded.keys() == expected.keys()
    for name, array in expected.items():
        assert loaded[name].dtype == array.dtype and loaded[name].tobytes() == array.tobytes(), name
    passed_over = [name for name in damaged if name > whole[-1]]
    assert len(notices) == len(passed_over) and all(any(name in notice for notice in notices) for name in passed_over)
    shutil.rmtree(folder)
    return int(whole[-1][-8:])


def test_damaged_files_are_named_and_the_last_whole_checkpoint_is_used(stopped, tmp_path):
    outcomes = [damage_and_load(stopped, tmp_path, seed) for seed in range(40)]
    assert {7, 8} <= set(outcomes)


@pytest.mark.slow
def test_two_hundred_damages_are_resumed_to_the_bit_or_refused(stopped, tmp_path, uninterrupted):
    resumed = 0
    for seed in range(1000, 1200):
        if damage_and_load(stopped, tmp_path, seed) is None:
            continue
        rng = np.random.default_rng(seed)
        folder = Path(shutil.copytree(stopped, tmp_path / "again"))
        for path in rng.choice(files(folder), size=int(rng.integers(1, 4)), replace=False):
            damage(path, rng)
        assert same_result(run(folder, task="jump"), uninterrupted), seed
        resumed += 1
        shutil.rmtree(folder)
    assert resumed > 100


def test_a_damaged_newest_checkpoint_costs_its_generations_and_no_more(folder, uninterrupted):
    rng = np.random.default_rng(5)
    damage(rng.choice(files(folder / "generation_00000008")), rng)
    notices = []
    found = run(folder, notices=notices, task="jump")
    assert found.resumed_at == 7 and same_result(found, uninterrupted)
    assert len(notices) == 1 and "generation_00000008 is damaged" in notices[0] and "00000007" in notices[0]
    assert names(folder) == [f"generation_{i:08d}" for i in (10, 11, 12)]


def test_if_none_is_whole_every_damaged_file_is_named(folder):
    for generation in (6, 7, 8):
        (folder / f"generation_{generation:08d}" / "state" / "_METADATA").write_bytes(b"{")
    with pytest.raises(es.CheckpointError) as refusal:
        run(folder, task="jump")
    assert str(refusal.value).count("state/_METADATA does not match its checksum") == 3
    assert "\n" not in str(refusal.value)


def forge(folder: Path, change) -> None:
    """Rewrite a manifest with sums that are right, as only an attacker would."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    for name in manifest["files"]:
        content = (folder / name).read_bytes() if (folder / name).is_file() else b""
        manifest["files"][name] = {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    manifest.pop("sha256")
    manifest["sha256"] = hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()
    path.write_text(json.dumps(manifest))


def test_a_forged_checkpoint_reads_nothing_outside_its_folder(folder):
    newest = folder / "generation_00000008"
    forge(newest, lambda manifest: manifest["files"].update({"../../../../etc/passwd": {}}))
    notices = []
    assert run(folder, notices=notices, task="jump").resumed_at == 7
    assert "../../../../etc/passwd is missing" in notices[0]


def test_a_forged_checkpoint_follows_no_link(folder):
    newest = folder / "generation_00000008"
    target = newest / "state" / "_METADATA"
    target.unlink()
    target.symlink_to("/etc/passwd")
    forge(newest, lambda manifest: None)
    with pytest.raises(checkpoint_files.Damaged, match="_METADATA is not a plain file"):
        checkpoint_files.read_manifest(newest)


def test_a_forged_checkpoint_that_claims_much_memory_is_not_read(folder, monkeypatch):
    """The claim is in the arrays' own metadata, with sums that are right; the limit is lowered to below this size."""
    monkeypatch.setattr(checkpoint_files, "LARGEST_STATE", 100)
    with pytest.raises(es.CheckpointError, match="larger than 100 bytes"):
        run(folder, task="jump")
    with pytest.raises(checkpoint_files.Damaged, match="its arrays claim"):
        checkpoint_files.read_arrays(folder / "generation_00000008")


@pytest.mark.parametrize(
    "content", [b"", b"null", b"[]", b'{"sha256": 1}', b"[" * 100_000, b"{" + b"1" * 2**21, b"\xff"]
)
def test_a_manifest_that_is_no_manifest_is_damage(folder, content):
    (folder / "generation_00000008" / "manifest.json").write_bytes(content)
    notices = []
    checkpointer = es.Checkpointer(folder, {"task": "jump"}, notify=notices.append)
    fingerprint = json.loads((folder / "generation_00000007" / "manifest.json").read_text())["fingerprint"]
    checkpointer.open(fingerprint["search"])
    assert checkpointer.load()["position"].tolist() == [1, 1]  # generation 7 is the first of the second stage
    assert "manifest.json does not match its checksum" in notices[0]


def test_arrays_that_do_not_fit_the_search_are_refused(tmp_path):
    checkpointer = es.Checkpointer(tmp_path, seconds_between=0.0)
    key = jax.random.key(0)
    checkpointer.open(describe(space(), TWO_STAGES, SETTINGS, key))
    checkpointer.save(3, {"position": np.array([0, 3]), "strategy.mean": np.zeros(9, np.float32)})
    with pytest.raises(es.CheckpointError, match=r"does not fit this search: 'strategy"):
        run(tmp_path)


def test_a_full_disk_is_one_sentence_and_loses_nothing(folder, uninterrupted):
    """A limit on the size of files stands for the disk; the checkpoint's files are larger."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def filling(stage, x, key):
        resource.setrlimit(resource.RLIMIT_FSIZE, (512, hard))
        return distance_squared(stage, x, key)

    try:
        with pytest.raises(es.CheckpointError, match=r"generation_00000009 cannot be written") as refusal:
            run(folder, filling, task="jump")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert "\n" not in str(refusal.value)
    found = run(folder, task="jump")
    assert found.resumed_at == 8 and same_result(found, uninterrupted)


def test_a_folder_that_cannot_be_one_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(es.CheckpointError, match="cannot be used: "):
        run(tmp_path / "file" / "checkpoints")
    with pytest.raises(ValueError, match="must be JSON values"):
        run(tmp_path, model=object())


def test_a_killed_process_is_resumed_to_the_bit(tmp_path, uninterrupted):
    process = subprocess.Popen(
        [sys.executable, HERE / "killed_search.py", tmp_path], stdout=subprocess.PIPE, text=True, cwd=HERE
    )
    try:
        done = [int(process.stdout.readline()) for _ in range(7)][-1]
    finally:
        process.kill()
        process.communicate()
    found = run(tmp_path)
    assert 0 < done - 1 <= found.resumed_at < 12
    assert same_result(found, uninterrupted)


def test_ctrl_c_at_any_moment_is_resumed_to_the_bit(tmp_path, uninterrupted):
    """Real signals at random times: they strike in the evaluation, in JAX, in the writing of a checkpoint."""

    def unhurried(stage, x, key):
        time.sleep(SHORTEST_GENERATION)
        return distance_squared(stage, x, key)

    rng = np.random.default_rng(0)
    before = signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(signal.SIGINT))
    struck, found = 0, None
    try:
        while found is None and struck < 12:
            try:
                signal.setitimer(signal.ITIMER_REAL, rng.uniform(1.0, 10.0) * SHORTEST_GENERATION)
                found = run(tmp_path, unhurried)
            except (es.SearchInterrupted, KeyboardInterrupt):  # the latter before the first generation
                struck += 1
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert same_result(found if found is not None else run(tmp_path), uninterrupted)
    if struck == 0:  # Python drops what is raised inside a callback of its own, such as one of a weak reference
        pytest.skip("every signal struck where Python cannot raise")


def kill_writers(folder: Path, kills: int) -> list[int]:
    """Generations that the processes found, one after the other."""
    done = subprocess.run(
        [sys.executable, HERE / "killed_writer.py", folder, str(kills)], capture_output=True, text=True, cwd=HERE
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return [int(line) for line in done.stdout.split()]


def test_a_kill_while_writing_leaves_a_whole_checkpoint(tmp_path):
    found = kill_writers(tmp_path, 10)
    assert len(found) == 11 and found == sorted(found) and found[-1] >= 10


@pytest.mark.slow
def test_two_hundred_kills_while_writing(tmp_path):
    found = kill_writers(tmp_path, 200)
    assert len(found) == 201 and found == sorted(found) and found[-1] >= 200


def test_importing_the_package_starts_no_backend():
    """Else the number of devices could not be set any more by who imports it."""
    code = "import es, jax; jax.config.update('jax_num_cpu_devices', 3); assert jax.device_count() == 3"
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ)
