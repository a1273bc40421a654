"""Damaged inputs: each is refused with its place, or harmless; nothing is written."""

import random
import re
import struct

import numpy as np
import pytest
from support import (
    Deck,
    SimulationError,
    UsageError,
    list_gallery,
    read_checked_circuit,
    read_raw,
    require_valid_wiring,
)

TOKENS = (
    "nan", "inf", "-1", "0", "1e999", "1e-400", "-1e30", '""', '"1 parsec"', '"3"', "true", "[]",
    "{}", "99999999999999999999", '"\\u0000"', "'", '"', "[", "]", "{", "=", "\x00", "\r", "\u2028",
    "é", "%", "$", "`", "../", ".control", ".include /etc/hostname", "+", "*", "#", "1/0", "\t",
)  # fmt: skip


def seeds(fast, full):
    """Of all cases of one kind; those beyond the fast ones are marked as slow."""
    late = [pytest.param(range(k, k + 50), marks=[pytest.mark.slow, pytest.mark.campaign])
            for k in range(fast, full, 50)]  # fmt: skip
    return [range(fast), *late]


def mutated(text, rng):
    """One to three changes: a token put in or over a value, lines lost, doubled, swapped or cut."""
    for _ in range(rng.randint(1, 3)):
        lines = text.split("\n")
        row = rng.randrange(len(lines))
        line = lines[row]
        column = rng.randrange(len(line) + 1)
        token = rng.choice(TOKENS)
        match rng.randrange(8):
            case 0:
                lines[row] = line[:column] + token + line[column:]
            case 1:
                lines[row] = re.sub(r"=.*", lambda _, t=token: f"= {t}", line)
            case 2:
                lines[row] = line[:column] + line[column + 1 :]
            case 3:
                lines[row:row] = [rng.choice(lines)]
            case 4:
                del lines[row]
            case 5:
                lines[row] = re.sub(r"[0-9.]+", lambda _, t=token: t, line, count=1)
            case 6:
                lines[row] = line[:column] + chr(rng.randrange(1, 256)) + line[column + 1 :]
            case 7:
                lines = lines[: row + 1]
        text = "\n".join(lines)
    return text


def damaged(content, rng):
    """Bytes flipped, cut out, doubled or cut off."""
    data = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(data))
        match rng.randrange(4):
            case 0:
                data[at] = rng.randrange(256)
            case 1:
                del data[at : at + rng.randrange(1, 9)]
            case 2:
                data[at:at] = data[at : at + rng.randrange(1, 9)]
            case 3:
                del data[max(1, at) :]
        if not data:
            break
    return bytes(data)


def files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(done, place):
    """Exit code 2, one message, which says where; no trace of an exception."""
    assert done.exit_code == 2, done.output
    assert "Traceback" not in done.output
    assert "internal error" not in done.output
    assert re.search(place, done.output), done.output


@pytest.mark.parametrize("chunk", seeds(50, 900))
def test_damaged_scenes_are_refused_with_key_or_line(chunk, cli, tmp_path, monkeypatch):
    """``run`` gets as far as the study, which is replaced, or says which line or key is wrong."""
    monkeypatch.setattr(
        "kc2spice.workflow.run.run_scene", lambda *_, **__: {"wall_s": {}, "files": []}
    )
    texts = [path.read_text(encoding="utf-8") for path in list_gallery().values()]
    bad = 0
    for seed in chunk:
        rng = random.Random(f"scene {seed}")
        content = mutated(rng.choice(texts), rng)
        (tmp_path / "scene.toml").write_bytes(content.encode("utf-8", "replace"))
        done = cli("run", "scene.toml", "--out", "out", "--quiet")
        if done.exit_code:
            refused(
                done,
                r"(?s)scene\.toml.*(line \d+|key \S+|at end of document|UTF-8)|did you mean"
                r"|\.lib: this file does not exist"  # the folder contains the scene alone
                r"|scene\.toml: the scene has no parts",
            )
            bad += 1
        assert set(files(tmp_path)) == {tmp_path / "scene.toml"}
    assert bad > len(chunk) / 3


@pytest.mark.parametrize("chunk", seeds(60, 200))
def test_damaged_raw_files_are_refused_or_finite(chunk, tmp_path):
    head = (
        b"Title: t\nDate: d\nPlotname: Transient Analysis\nFlags: real\nNo. Variables: 3\n"
        b"No. Points: 20\nVariables:\n\t0\ttime\ttime\n\t1\tv(a)\tvoltage\n\t2\tv(b)\tvoltage\n"
        b"Binary:\n"
    )  # fmt: skip
    whole = head + struct.pack("<60d", *np.random.default_rng(0).normal(size=60))
    path = tmp_path / "a.raw"
    bad = 0
    for seed in chunk:
        rng = random.Random(f"raw {seed}")
        near_head = rng.random() < 0.5
        content = damaged(head, rng) + whole[len(head) :] if near_head else damaged(whole, rng)
        path.write_bytes(content)
        try:
            vectors = read_raw(path)
        except SimulationError as error:
            assert "a.raw" in str(error)
            bad += 1
        else:
            assert all(np.isfinite(values).all() for values in vectors.values())
    assert bad > len(chunk) / 3


MAIN = """* t
V1 c 0 1
X1 c d 0 driver
R1 d 0 1k
.include user.lib
.tran 1u 1m
.save v(d)
.end
"""


@pytest.mark.parametrize("chunk", seeds(50, 400))
def test_damaged_circuits_are_refused_with_their_line(chunk, tmp_path):
    text = (list_gallery()["bring_your_own"].parent / "bring_your_own.lib").read_text(
        encoding="utf-8"
    )
    name = re.search(r"(?im)^\.subckt\s+(\w+)", text)[1]
    main = MAIN.replace("driver", name)
    bad = 0
    for seed in chunk:
        rng = random.Random(f"include {seed}")
        path = tmp_path / "user.lib"
        path.write_bytes(mutated(text, rng).encode("utf-8", "replace"))
        try:
            library = read_checked_circuit(path).text
            require_valid_wiring(Deck(name="t", text=main, more={"user.lib": library}, stop=1e-3))
        except UsageError as error:
            assert re.match(r"(user\.lib|t\.cir)(:\d+)?$|.*user\.lib", str(error.where)), error
            bad += 1
    assert bad > len(chunk) / 4
