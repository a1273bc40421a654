"""Files of instruments: every layout against its circuit, what is ambiguous, and damaged files."""

import random
import re
import resource
import time
from pathlib import Path

import numpy as np
import pytest
from instrument_layouts import AD2, DEG, E4990, GAIN, LAYOUTS, SHUNT, TRACE_A, F, S, Y, Z, rows
from support import app, parse_shunt_resistance, read_measured, reduce_file
from typer.testing import CliRunner

import kc2spice as kc

FILES = Path(__file__).parents[1] / "data" / "instruments"
REFUSED = kc.errors.UsageError


def written(folder, name, text):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_is_the_same_circuit(tmp_path, name):
    layout = LAYOUTS[name]
    path = written(tmp_path, layout.name, layout.text)
    data = read_measured(path, layout.shunt)
    assert data.f == pytest.approx(F, rel=1e-9)
    assert np.abs(data.Y[:, 0, 0] / Y - 1).max() < (2e-5 if "f}" in layout.form else 1e-6)


def plain_numbers(name, skip, separator, columns):
    """Columns of a real file by their place, without the reader."""
    lines = (FILES / name).read_text(encoding="latin-1").splitlines()[skip:]
    numbers = [line.split(separator) for line in lines if line.strip() not in ("", "END")]
    return np.array([[float(row[k]) for k in columns] for row in numbers]).T


def polar(size, degrees):
    return size * np.exp(1j * np.deg2rad(degrees))


def test_files_of_real_instruments():
    """By the places of their columns; sources are listed beside the files."""
    f, R, X = plain_numbers("e4990a_rx.csv", 5, ",", (0, 1, 2))
    data = read_measured(FILES / "e4990a_rx.csv")
    assert data.f == pytest.approx(f)
    assert 1 / data.Y[:, 0, 0] == pytest.approx(R + 1j * X)
    for name, skip in (("e4990a_ztheta.csv", 5), ("wayne_kerr_6515b.csv", 1)):
        f, size, angle = plain_numbers(name, skip, ",", (0, 1, 2))
        data = read_measured(FILES / name)
        assert data.f == pytest.approx(f)
        assert 1 / data.Y[:, 0, 0] == pytest.approx(polar(size, angle))
    assert data.notes == ("Impedance (O): unit O, read as Ohm",)


def test_a_real_gain_is_the_resistor_that_was_measured():
    """47 Ohm and 100 Ohm by their colour codes, of 5 %; the oscilloscope measures to 10 MHz."""
    data = read_measured(FILES / "rohde_schwarz_gain.csv", parse_shunt_resistance("100 Ohm"))
    low = data.f < 1e5
    assert np.abs(1 / data.Y[low, 0, 0] / 47.0 - 1).max() < 0.05
    assert "with a shunt of 100 Ohm" in " ".join(data.notes)


def test_a_shunt_selects_the_gain_beside_an_impedance(tmp_path):
    """The gain is of another part; with a shunt it counts, without one the impedance."""
    other = SHUNT / (3 * Z + SHUNT)
    head = "f_hz,|Z| (Ohm),phase (deg),Gain Real (-),Gain Imaginary (-)\n"
    path = written(tmp_path, "a.csv", head + rows(F, abs(Z), DEG, other.real, other.imag))
    assert read_measured(path).Y[:, 0, 0] == pytest.approx(Y, rel=1e-6)
    assert read_measured(path, SHUNT).Y[:, 0, 0] == pytest.approx(Y / 3, rel=1e-6)
    head = "f_hz,|Z| (Ohm),phase (deg),Gain (dB),Gain Phase (deg)\n"
    size, angle = 20 * np.log10(abs(other)), np.angle(other, deg=True)
    path = written(tmp_path, "b.csv", head + rows(F, abs(Z), DEG, size, angle))
    assert read_measured(path).Y[:, 0, 0] == pytest.approx(Y, rel=1e-6)
    assert read_measured(path, SHUNT).Y[:, 0, 0] == pytest.approx(Y / 3, rel=1e-6)


def test_noise_of_a_gain_is_absolute(tmp_path):
    """Noise of g gives that of Y by repeated measurement, without the reader's formula."""
    draws = np.random.default_rng(3).normal(size=(2, len(F)))
    noisy = GAIN + 1e-4 * (draws[0] + 1j * draws[1])
    head = "f (Hz),Gain Real (-),Gain Imaginary (-)\n"
    path = written(tmp_path, "a.csv", head + rows(F, noisy.real, noisy.imag))
    data = read_measured(path, SHUNT)
    many = np.random.default_rng(4).normal(size=(2, 2000, len(F))) * 1e-4
    repeated = GAIN + many[0] + 1j * many[1]
    admittance = 1 / (SHUNT * (1 / repeated - 1))
    spread = np.std(admittance.real, axis=0)
    assert np.median(data.admittance_noise[:, 0, 0] / spread) == pytest.approx(1, rel=0.2)


def test_the_commands_accept_a_shunt(tmp_path):
    path = FILES / "rohde_schwarz_gain.csv"
    words = ["reduce", str(path), "-o", str(tmp_path / "out"), "--shunt"]
    done = CliRunner().invoke(app, [*words, "100 Ohm"])
    assert done.exit_code == 0, done.output
    text = " ".join(done.output.split())
    assert "gain [dB] from 'Gain in dB', phase [°] from 'Phase in °'" in text
    assert (
        "note: gain: shunt voltage divided by source voltage, with a shunt of 100 Ohm in series"
        in text
    )
    for value, message in (("-3 Ohm", "not a resistance"), ("3 kg", "Ohm")):
        done = CliRunner().invoke(app, [*words, value])
        assert done.exit_code == 2
        assert message in done.output
    impedance = written(tmp_path, "z.csv", LAYOUTS["Hioki"].text)
    for case in (impedance, written(tmp_path, "a.s1p", LAYOUTS["NanoVNA"].text)):
        with pytest.raises(REFUSED, match="--shunt: this option applies only to a table of gain"):
            reduce_file(case, tmp_path / "no", shunt="330 Ohm")
    words = ["fit", "buzzer_7bb_20_3:disc", str(impedance), "--vary", "damping.quality"]
    done = CliRunner().invoke(app, [*words, "--shunt", "330 Ohm", "-o", str(tmp_path / "no")])
    assert done.exit_code == 2
    assert "--shunt: this option applies only to a table of gain" in done.output
    with pytest.raises(REFUSED, match="the argument shunt applies only to a file"):
        kc.fit(
            "buzzer_7bb_20_3", "disc", read_measured(impedance), {"damping.quality": None}, shunt=3
        )
    np.savez(tmp_path / "chain.npz", M=np.eye(2), K=np.eye(2) * 4.0, B=np.eye(2)[:, :1])
    with pytest.raises(REFUSED, match="--shunt: this option applies only to a measured response"):
        reduce_file(tmp_path / "chain.npz", tmp_path / "no", shunt=330.0)


AMBIGUOUS = {
    "no titles": ("a.csv", rows(F, Z.real, Z.imag), ("R and X in Ohm", "|Z| in Ohm and phase")),
    "two sweeps": (
        "a.csv",
        E4990 + "Frequency(Hz), R(Ohm)-data, X(Ohm)-data\n" + rows(F, Z.real, Z.imag)
        + "END\n\nBEGIN CH2_DATA\nFrequency(Hz), R(Ohm)-data, X(Ohm)-data\n"
        + rows(2 * F, Z.real, Z.imag) + "END\n",
        ("2 sweeps", "lines 6 to 106", "lines 111 to 211"),
    ),
    "two sweeps in one table": (
        "a.csv", "f_hz,R (Ohm),X (Ohm)\n" + rows(*(np.tile(x, 2) for x in (F, Z.real, Z.imag))),
        ("2 sweeps in one table", "rows 1 to 101", "rows 102 to 202"),
    ),
    "scales of a trace": (
        "a.txt", TRACE_A.replace("|Z|", "LOG") + rows(F, abs(Z), 0 * F, separator="\t"),
        ("'Data Trace Imag'",)),
    "two parts": (
        "a.csv", "f_hz,A R (Ohm),A X (Ohm),CH1 R (Ohm),CH2 R (Ohm),X (Ohm)\n"
        + rows(F, Z.real, Z.imag, Z.real, 2 * Z.real, Z.imag),
        ("two columns of R", "'CH1 R (Ohm)'", "'CH2 R (Ohm)'"),
    ),
    "two channels": (
        "a.csv", "f_hz,CH1 |Z| (Ohm),CH1 phase (deg),CH2 |Z| (Ohm),CH2 phase (deg)\n"
        + rows(F, abs(Z), DEG, 2 * abs(Z), DEG + 9),
        ("two columns of |Z|", "'CH1 |Z| (Ohm)'", "'CH2 |Z| (Ohm)'"),
    ),
    "kilohms that are ohms": (
        "a.csv", AD2 + "Frequency (Hz),Trace th (deg),Trace |Z| (kOhm),Trace Rs (Ohm),"
        "Trace Xs (Ohm)\n"
        + rows(F, DEG, abs(Z), Z.real, Z.imag),
        ("'Trace Rs (Ohm)'", "'Trace |Z| (kOhm)'"),
    ),
    "E5061B": (
        "a.csv", '"# Channel 1"\n"# Trace 1"\nFrequency, Formatted Data, Formatted Data\n'
        + rows(F, S.real, S.imag, separator=", "),
        ("'Formatted Data'", "real and imaginary parts of S11 or Z", "and a column of zeros"),
    ),
    "real and imag": ("a.csv", "freq,real,imag\n" + rows(F, Z.real, Z.imag),
                      ("'real'", "R in Ohm or G in S")),
    "magnitude in dB": ("a.csv", "f_hz,Magnitude (dB),Phase (deg)\n" + rows(F, abs(GAIN), DEG),
                        ("gain [dB]", "--shunt '100 Ohm'")),
    "two complex columns": ("a.csv", "f_hz,Z (Ohm),Y (S)\n" + rows(F, Z, 2 * Y),
                            ("'Z (Ohm)'", "'Y (S)'")),
    "sound": ("a.frd", "Freq[Hz]     dBSPL  Phase[Deg]\n" + rows(F, abs(Z), DEG, separator=" "),
              ("'dBSPL'", "sound pressure")),
    "sound in a comment": (
        "a.frd", "* Data: Frequency (Hertz), SPL (dB), Phase (degrees)\n"
        + rows(F, abs(Z), DEG, separator=" "), ("'SPL (dB)'", "sound pressure")),
    "trace that is not zero": (
        "a.txt", TRACE_A + rows(F, abs(Z), 1e3 * DEG, separator="\t"),
        ("'Data Trace Imag'", "the format |Z|")),
    "commas of both kinds": (
        "a.csv", "f_hz,R,X\n" + "".join(f"{k},5,{k},25,{k},125\n" for k in range(10, 40)),
        ("the comma separates the 3 columns, and it is also the decimal character",
         "semicolons between the columns")),
    "radians that are degrees": (
        "a.csv", "FREQ[Hz],Z[ohm],PHASE[rad]\n" + rows(F, abs(Z), DEG),
        ("exceeds a full turn", "write the title PHASE[deg] if the phases are in degrees")),
    "degrees beyond a full turn": (
        "a.csv", "FREQ[Hz],Z[ohm],PHASE[deg]\n" + rows(F, abs(Z), DEG - 720),
        ("exceeds a full turn", "subtract full turns")),
    "farad squared": (
        "a.csv", "Freq(Hz),Cp(FF),D\n" + rows(F, Y.imag, Y.real), ("'FF' is not a unit",)),
    "milli or mega": ("a.csv", "FREQ(HZ),R(MOHM),X(MOHM)\n" + rows(F, Z.real, Z.imag),
                      ("'MOHM'", "milli or mega")),
    "words in rows": (
        "a.csv", "f_hz,R,X\n" + "".join(f"{k},{5 if k % 9 else 'OVLD'},3\n" for k in range(101)),
        ("'OVLD' in column 'R'", "12 of 101 rows")),
}  # fmt: skip


@pytest.mark.parametrize("case", AMBIGUOUS)
def test_an_ambiguous_file_is_refused_with_its_readings(tmp_path, case):
    name, text, words = AMBIGUOUS[case]
    path = written(tmp_path, name, text)
    with pytest.raises(REFUSED) as caught:
        read_measured(path)
    message = " ".join(str(caught.value).split())
    for word in words:
        assert word in message, message
    assert str(path) in message
    assert "next:" in str(caught.value)


def test_a_touchstone_file_with_two_kinds_or_negative_magnitudes_is_refused(tmp_path):
    body = rows(F, -S.real, S.imag, separator=" ")
    for option, words in (
        ("# z S RI R 50", "both 'z' and 's'"),
        ("# Hz S R 50", "a magnitude is negative"),
    ):
        path = written(tmp_path, "a.s1p", option + "\n" + body)
        with pytest.raises(REFUSED, match=words):
            read_measured(path)
    path = written(tmp_path, "a.s1p", "# S RI R 50\n" + rows(F, S.real, S.imag, separator=" "))
    assert "no frequency unit; GHz is assumed" in " ".join(read_measured(path).notes)


def test_a_port_that_was_not_driven_is_refused(tmp_path):
    """The analyser has one source; it writes zeros for S12 and S22."""
    zero = 0 * F
    body = rows(F, S.real, S.imag, zero + 0.01, zero, zero, zero, zero, zero, separator=" ")
    path = written(tmp_path, "a.s2p", "# HZ S RI R 50\n" + body)
    with pytest.raises(REFUSED, match="did not drive port 2") as caught:
        read_measured(path)
    assert "export S11, the reflection at port 1, as a one-port file .s1p" in str(caught.value)


def test_a_reflection_above_one_names_the_calibration(tmp_path):
    body = rows(F, -1.02 * np.ones(len(F)), 1e-3 * F / F[0], separator=" ")
    path = written(tmp_path, "a.s1p", "# HZ S RI R 50\n" + body)
    with pytest.raises(REFUSED, match=r"calibrate the analyser: \|S\| is up to 1.02, above 1"):
        read_measured(path)


@pytest.mark.parametrize("triangle", ["Lower", "Upper"])
def test_a_triangle_of_a_touchstone_file_is_the_full_matrix(tmp_path, triangle):
    """Three ports in delta; rows of a triangle as in the standard of version 2."""
    series = np.array([Z, 2 * Z, 3 * Z + 10])
    delta = np.zeros((len(F), 3, 3), dtype=complex)
    for (a, b), z in zip(((0, 1), (1, 2), (0, 2)), series, strict=True):
        delta[:, [a, b], [a, b]] += (1 / z)[:, None]
        delta[:, [a, b], [b, a]] -= (1 / z)[:, None]
    one = np.eye(3)
    waves = np.linalg.solve(one + 50 * delta, one - 50 * delta)
    lines = []
    for f, matrix in zip(F, waves, strict=True):
        for k in range(3):
            part = matrix[k, : k + 1] if triangle == "Lower" else matrix[k, k:]
            start = f"{f:.9g} " if k == 0 else "  "
            lines.append(start + " ".join(f"{x.real:.12g} {x.imag:.12g}" for x in part))
    head = "[Version] 2.0\n# Hz S RI R 50\n[Number of Ports] 3\n"
    head += f"[Number of Frequencies] {len(F)}\n[Matrix Format] {triangle}\n[Network Data]\n"
    data = read_measured(written(tmp_path, "a.ts", head + "\n".join(lines) + "\n[End]\n"))
    assert np.abs(data.Y - delta).max() < 1e-8 * np.abs(delta).max()


def test_rows_that_contain_a_word_are_left_out_with_a_note(tmp_path):
    lines = rows(F, Z.real, Z.imag).splitlines()
    lines[40] = lines[40].rpartition(",")[0] + ",nan"
    path = written(tmp_path, "a.csv", "f_hz,R (Ohm),X (Ohm)\n" + "\n".join(lines) + "\n")
    data = read_measured(path)
    assert len(data.f) == len(F) - 1
    assert (
        "line 42: 'nan' in column 'X (Ohm)' is not a number: 1 of 101 rows left out" in data.notes
    )


def test_a_column_that_is_not_needed_does_no_harm(tmp_path):
    """The phase in degrees has a title in radians; the file contains Rs and Xs as well."""
    head = AD2 + "Frequency (Hz),Trace th (rad),Trace |Z| (Ohm),Trace Rs (Ohm),Trace Xs (Ohm)\n"
    path = written(tmp_path, "a.csv", head + rows(F, DEG, abs(Z), Z.real, Z.imag))
    data = read_measured(path)
    assert data.Y[:, 0, 0] == pytest.approx(Y, rel=1e-6)
    assert "not used: column 'Trace th (rad)'" in " ".join(data.notes)


def test_encodings_of_programs(tmp_path):
    text = LAYOUTS["Bode 100, new"].text
    for k, data in enumerate((
        text.encode("utf-8-sig"),
        text.encode("utf-16"),
        text.replace("\n", "\r\n").encode(),
        text.encode().decode("latin-1").encode(),  # encoded twice
    )):  # fmt: skip
        path = tmp_path / f"{k}.csv"
        path.write_bytes(data)
        assert read_measured(path).Y[:, 0, 0] == pytest.approx(Y, rel=1e-6)


BOMBS = {
    "lines": "f,R,X\n" + "1,1,1\n" * 3_000_000,
    "columns": "f,R,X\n" + "1," * 9_000_000,
    "title": "f" * 9_000_000 + ",R,X\n" + rows(F, Z.real, Z.imag),
    "titles": "f(" * 400_000 + "\n" + rows(F, Z.real, Z.imag),
    "quotes": '"' * 5_000_000,
    "digits": "f,R,X\n" + ("1" * 4_000_000 + ",1,1\n") * 3,
    "blanks": " " * 10_000_000 + "\n" + rows(F, Z.real, Z.imag),
    "header": "x\n" * 90_000 + rows(F, Z.real, Z.imag),
    "brackets": "*" + "([" * 300_000 + "\n* Data: " + "(" * 100_000 + rows(F, Z.real, Z.imag),
}


@pytest.mark.parametrize("name", BOMBS)
@pytest.mark.parametrize("suffix", [".csv", ".zma"])
def test_large_files_end_in_time_and_memory(tmp_path, name, suffix):
    path = written(tmp_path, f"a{suffix}", BOMBS[name])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.process_time()
    try:
        read_measured(path)
    except REFUSED as error:
        assert len(str(error)) < 2000
    assert time.process_time() - begin < 10
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000  # kilobytes


# --- damaged files --------------------------------------------------------------------------------


def prefixed(text, chance):
    """Another prefix of the frequency with its numbers scaled."""
    lines = text.splitlines()
    row = next((k for k, line in enumerate(lines) if "(Hz)" in line), None)
    if row is None or not lines[row].lstrip("#* ").lower().startswith("freq"):
        return text  # the first column is another one
    lines[row] = lines[row].replace("(Hz)", "(kHz)")
    for k in range(row + 1, len(lines)):
        word = lines[k].split(",")[0].split(";")[0].split()[:1]
        if word and word[0].lstrip("+")[:1].isdigit():
            number = word[0].rstrip(",")
            lines[k] = lines[k].replace(number, f"{float(number) / 1e3:.12g}", 1)
    return "\n".join(lines) + "\n"


def radians(text, chance):
    """Radians in the titles above degrees; a reflection may turn any number of times."""
    return text if "S11" in text else text.replace("deg", "rad")


def first_row(text):
    """Number of the first line of numbers of a text."""
    lines = text.splitlines()
    return next(k for k, line in enumerate(lines) if line.strip()[:1] in tuple("+0123456789("))


def in_titles(change):
    """A mutation of one random character of the last line above the numbers, but not of a minus or
    a digit, without which the file states another sign or another reference resistance."""

    def mutate(text, chance):
        lines = text.splitlines(keepends=True)
        row = first_row(text) - 1
        if row < 0 or not lines[row].strip():
            return text
        places = [k for k, letter in enumerate(lines[row]) if letter not in "-0123456789\n"]
        place = chance.choice(places)
        line = lines[row]
        lines[row] = line[:place] + change(line[place], chance) + line[place + 1 :]
        return "".join(lines)

    return mutate


def in_rows(change):
    """A mutation of one random word of a random row of numbers."""

    def mutate(text, chance):
        lines = text.splitlines(keepends=True)
        row = chance.randrange(first_row(text), len(lines))
        words = lines[row].split()
        if words:
            lines[row] = lines[row].replace(chance.choice(words), change(chance), 1)
        return "".join(lines)

    return mutate


def with_line(action):
    def mutate(text, chance):
        lines = text.splitlines(keepends=True)
        action(lines, chance.randrange(len(lines)), chance)
        return "".join(lines)

    return mutate


def delete(lines, row, chance):
    del lines[row]


def repeat(lines, row, chance):
    lines.insert(row, lines[row])


def insert(lines, row, chance):
    lines.insert(row, chance.choice(["\n", "# remark\n", "page 2\n", "-----\n", "\x0c\n", "1\n"]))


def swap(lines, row, chance):
    other = chance.randrange(len(lines))
    lines[row], lines[other] = lines[other], lines[row]


MUTATIONS = {
    "as it is": lambda text, chance: text,
    "carriage returns": lambda text, chance: text.replace("\n", "\r\n"),
    "byte order mark": lambda text, chance: "\ufeff" + text,
    "blank lines": lambda text, chance: text.replace("\n", "\n\n"),
    "trailing separators": lambda text, chance: text.replace("\n", " \n"),
    "comment above": lambda text, chance: "# measured by hand\n" + text,
    "kilohertz": prefixed,
    "decimal commas": lambda text, chance: text.replace(",", ";").replace(".", ","),
    "tabs": lambda text, chance: text.replace(", ", ",").replace(",", "\t"),
    "square brackets": lambda text, chance: text.replace("(", "[").replace(")", "]"),
    "title letter deleted": in_titles(lambda letter, chance: ""),
    "title letter changed": in_titles(lambda letter, chance: chance.choice("wv?#~9")),
    "title letter doubled": in_titles(lambda letter, chance: letter * 2),
    "no brackets": lambda text, chance: text.replace("(", "").replace(")", ""),
    "no units": lambda text, chance: text.replace("(Ohm)", "").replace("(deg)", ""),
    "radians stated": radians,
    "word in a row": in_rows(lambda chance: chance.choice(["nan", "OVLD", "---", "x"])),
    "row cut": lambda text, chance: text[: chance.randrange(first_row(text) + 1, len(text))],
    "cut to a page": lambda text, chance: "".join(text.splitlines(True)[: first_row(text) + 5]),
    "line deleted": with_line(delete),
    "line repeated": with_line(repeat),
    "line inserted": with_line(insert),
    "lines swapped": with_line(swap),
    "two sweeps": lambda text, chance: text + text,
    "binary inside": lambda text, chance: text[:300] + "\0\x01\ufffd" + text[300:],
}  # fmt: skip
HARMLESS = set(list(MUTATIONS)[:7])  # what every program may do: these must be read
ANYTHING = {"row cut", "word in a row"}  # the last row may be another one


def mutants(count, seed):
    """Layout, mutation, name of the layout and text of so many mutants of a seed."""
    chance = random.Random(seed)
    names, kinds = list(LAYOUTS), list(MUTATIONS)
    for k in range(count):
        layout = LAYOUTS[names[k % len(names)]]
        kind = kinds[(k * 7 + k // len(names)) % len(kinds)]
        yield layout, kind, names[k % len(names)], MUTATIONS[kind](layout.text, chance)


def judged(folder, count, seed):
    """Mutants that end in anything but a message, or are misread without a note that the file as
    it was does not have."""
    wrong, read, usual = [], 0, {}
    for name, layout in LAYOUTS.items():
        path = written(folder, layout.name, layout.text)
        usual[name] = set(read_measured(path, layout.shunt).notes)
    for number, (layout, kind, name, text) in enumerate(mutants(count, seed)):
        path = folder / f"{number}_{layout.name}"
        path.write_bytes(text.encode("utf-8", "replace"))
        try:
            data = read_measured(path, layout.shunt)
        except REFUSED as error:
            if kind in HARMLESS and not (kind == "comment above" and layout.name.endswith("s1p")):
                wrong.append((number, name, kind, str(error)))
            continue
        except Exception as error:
            wrong.append((number, name, kind, f"{type(error).__name__}: {error}"))
            continue
        read += 1
        expected = np.interp(data.f, F, Y.real) + 1j * np.interp(data.f, F, Y.imag)
        inside = (data.f > 0.999 * F[0]) & (data.f < 1.001 * F[-1])
        near = inside & (np.abs(data.Y[:, 0, 0] / expected - 1) < 0.02)
        more = " ".join({*data.notes} - usual[name])
        stated = "no unit" in more or "no format" in more
        if (~near).sum() > (1 if kind in ANYTHING else 0) and not stated:
            wrong.append((number, name, kind, data.description))
    return wrong, read


def test_forty_mutants_are_read_or_refused(tmp_path):
    wrong, read = judged(tmp_path, 40, seed=20)
    assert not wrong, wrong
    assert read > 12


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("seed", [20, 47, 48])
def test_five_hundred_mutants_are_read_or_refused(tmp_path, seed):
    wrong, read = judged(tmp_path, 500, seed)
    assert not wrong, wrong
    assert read > 200


HEAD = "f_hz,R (Ohm),X (Ohm)\n"


@pytest.mark.parametrize("end", ["110000,53", "110000,", "110000"])
def test_a_truncated_last_row_is_left_out_with_a_note(tmp_path, end):
    path = written(tmp_path, "a.csv", HEAD + rows(F, Z.real, Z.imag) + end)
    data = read_measured(path)
    assert len(data.f) == len(F)
    count = len(end.rstrip(",").split(","))
    note = f"line {len(F) + 2} has {count} of 3 columns: 1 of {len(F) + 1} rows left out"
    assert note in data.notes


def test_a_truncated_row_inside_the_table_does_not_divide_it(tmp_path):
    lines = rows(F, Z.real, Z.imag).splitlines()
    lines[40] = lines[40].rpartition(",")[0]
    data = read_measured(written(tmp_path, "a.csv", HEAD + "\n".join(lines)))
    np.testing.assert_allclose(data.Y[:, 0, 0], np.delete(Y, 40), rtol=1e-6)
    assert f"line 42 has 2 of 3 columns: 1 of {len(F)} rows left out" in data.notes


@pytest.mark.parametrize("word", ["OVL", "nan", "--"])
def test_rows_of_one_word_are_counted(tmp_path, word):
    lines = rows(F, Z.real, Z.imag).splitlines()
    few = [*lines[:9], *[f"{word},{word},{word}"] * 2, *lines[9:]]
    data = read_measured(written(tmp_path, "a.csv", HEAD + "\n".join(few)))
    np.testing.assert_allclose(data.Y[:, 0, 0], Y, rtol=1e-6)
    assert any(f"2 of {len(F) + 2} rows left out" in note for note in data.notes)
    many = [f"{word},{word},{word}" if k % 5 == 3 else line for k, line in enumerate(lines)]
    with pytest.raises(REFUSED) as caught:
        read_measured(written(tmp_path, "b.csv", HEAD + "\n".join(many)))
    count = sum(k % 5 == 3 for k in range(len(F)))
    assert f"line 5: {word!r} in column 'f_hz' is not a number" in caught.value.message
    assert f"{count} of {len(F)} rows have a fault, more than 5 %" in caught.value.message
    assert caught.value.hint == "measure these points again, or delete these rows from the file"
    kept = [line for line in many if word not in line]
    assert len(read_measured(written(tmp_path, "b.csv", HEAD + "\n".join(kept))).f) == len(kept)


def test_decimal_commas_beside_separating_commas_are_refused(tmp_path):
    text = rows(F, Z.real, Z.imag)
    with pytest.raises(REFUSED) as caught:
        read_measured(written(tmp_path, "a.csv", HEAD + text.replace(".", ",")))
    assert "the comma separates the 3 columns, and it is also the decimal" in caught.value.message
    assert "semicolons between the columns" in caught.value.hint
    right = (HEAD + text).replace(",", ";").replace(".", ",")
    assert len(read_measured(written(tmp_path, "a.csv", right)).f) == len(F)


def reflections(form):
    """Lines of a Touchstone file in the form RI or MA."""
    pair = (S.real, S.imag) if form == "RI" else (abs(S), np.rad2deg(np.angle(S)))
    return rows(F, *pair, separator=" ")


def test_a_touchstone_file_needs_an_option_line(tmp_path):
    text = reflections("RI")
    with pytest.raises(REFUSED) as caught:
        read_measured(written(tmp_path, "a.s1p", text))
    assert "the option line with the unit and the format is missing" in caught.value.message
    line = re.search("#.*?R 50", caught.value.hint)[0]
    data = read_measured(written(tmp_path, "a.s1p", f"{line}\n{text}"))
    np.testing.assert_allclose(data.Y[:, 0, 0], Y, rtol=1e-5)


@pytest.mark.parametrize(("name", "columns", "width"), [("a.s1p", 2, 3), ("a.s2p", 5, 9)])
def test_a_touchstone_file_with_missing_columns_is_refused(tmp_path, name, columns, width):
    text = rows(F, *[S.real] * (columns - 1), separator=" ")
    with pytest.raises(REFUSED) as caught:
        read_measured(written(tmp_path, name, "# Hz S RI R 50\n" + text))
    assert f"line 2 contains {columns} numbers" in caught.value.message
    assert f"has {width} numbers in each line" in caught.value.message


def nearly_open(form, head):
    """A resonator whose reflection is so close to 1 that RI can be taken for MA, or rad for deg."""
    f = np.linspace(2e3, 12e3, 300)
    w = 2j * np.pi * f
    admittance = 8e-9 * w + 1 / (500 + 0.6 * w + 1 / (1.05e-9 * w))
    s = (1 - 50 * admittance) / (1 + 50 * admittance)
    z = 1 / admittance
    pair = (s.real, s.imag) if form == "RI" else (abs(z), np.angle(z))
    return head + rows(f, *pair, separator=" " if form == "RI" else ",")


@pytest.mark.parametrize(
    ("name", "form", "head", "wrong", "right", "words"),
    [
        ("a.s1p", "RI", "# Hz S {} R 50\n", "MA", "RI", "write RI in place of MA"),
        ("a.csv", "rad", "Frequency (Hz),|Z| (Ohm),phase ({})\n", "deg", "rad",
         "if the phases are in radians, write rad in the title"),
    ],
)  # fmt: skip
def test_a_failed_fit_names_the_doubtful_format(tmp_path, name, form, head, wrong, right, words):
    path = written(tmp_path, name, nearly_open(form, head.format(wrong)))
    with pytest.raises(kc.errors.Kc2spiceError) as caught:
        reduce_file(path, tmp_path / "out")
    assert words in caught.value.hint
    assert not (tmp_path / "out").exists()
    path = written(tmp_path, name, nearly_open(form, head.format(right)))
    assert reduce_file(path, tmp_path / "out")["error_estimate"] < 1e-3


def test_a_spreadsheet_is_refused_with_the_name_of_a_table(tmp_path):
    (tmp_path / "meas.xlsx").write_bytes(b"PK")
    with pytest.raises(REFUSED, match="is a spreadsheet") as caught:
        reduce_file(tmp_path / "meas.xlsx")
    assert caught.value.hint == "save the sheet with the measurement as meas.csv"


def test_a_wrong_resistance_at_zero_frequency_lists_the_word_open(tmp_path):
    path = written(tmp_path, "a.csv", nearly_open("rad", "f_hz,|Z| (Ohm),phase (rad)\n"))
    for typed in ("closed", "0 Ohm"):
        with pytest.raises(REFUSED) as caught:
            reduce_file(path, tmp_path / "out", dc=typed)
        assert "the word open for a one-port without a DC path" in caught.value.expected
        assert caught.value.hint
    assert reduce_file(path, tmp_path / "out", dc="open")["error_estimate"] < 1e-3


@pytest.mark.parametrize("title", ["Phase (rad)", "PHASE[rad]", "phase_rad", "theta / rad"])
def test_the_advised_title_of_degrees_in_a_column_of_radians(tmp_path, title):
    def read(title):
        text = f"f_hz,|Z| (Ohm),{title}\n" + rows(F, abs(Z), DEG)
        return read_measured(written(tmp_path, "a.csv", text))

    with pytest.raises(REFUSED) as caught:
        read(title)
    advised = caught.value.hint.removeprefix("write the title  ").partition("  if")[0]
    assert advised == title.replace("rad", "deg")
    np.testing.assert_allclose(read(advised).Y[:, 0, 0], Y, rtol=1e-3)


def test_the_advised_title_of_a_column_with_a_wrong_unit(tmp_path):
    def read(title):
        return read_measured(
            written(tmp_path, "a.csv", f"f_hz,{title},X\n" + rows(F, Z.real, Z.imag))
        )

    with pytest.raises(REFUSED, match="not a unit of") as caught:
        read("R (kg)")
    read(caught.value.hint.partition("write the title  ")[2])


COMPLEX_ROWS = rows(F, Z.real, Z.imag)  # frequency, real and imaginary part


def advised_header(error):
    return re.search(r"name the columns in the first line, such as  (\S+)", error.hint)[1]


@pytest.mark.parametrize(
    ("titles", "unknown"),
    [("freq,a", "'a'"), ("index,value", "'index', 'value'"), ("freq,re", "")],
)
def test_one_column_with_an_unknown_title_names_title_and_header_at_once(tmp_path, titles, unknown):
    path = written(tmp_path, "a.csv", f"{titles}\n{rows(F, np.abs(Z))}")
    with pytest.raises(REFUSED) as caught:
        read_measured(path)
    error = caught.value
    assert error.message.startswith("this table contains only one column of values")
    assert error.message.endswith(f"unknown columns: {unknown}" if unknown else "needs two")
    header = advised_header(error)
    text = f"{header}\n{COMPLEX_ROWS}"
    assert read_measured(written(tmp_path, "b.csv", text)).Y[:, 0, 0] == pytest.approx(Y, rel=1e-6)


def test_all_titles_without_a_unit_are_named_at_once(tmp_path):
    lines = COMPLEX_ROWS.replace(",", ";")
    path = written(tmp_path, "a.csv", f"freq;re;im\n{lines}")
    with pytest.raises(REFUSED) as caught:
        read_measured(path)
    error = caught.value
    assert error.got == "columns 're', 'im'"
    assert error.expected == "re: R in Ohm or G in S; im: X in Ohm or B in S"
    titles = re.fullmatch(r"if the values are in Ohm, write the titles  (.*)", error.hint)[1]
    header = ";".join(["freq", *titles.split("  and  ")])
    text = f"{header}\n{lines}"
    assert read_measured(written(tmp_path, "b.csv", text)).Y[:, 0, 0] == pytest.approx(Y, rel=1e-6)


def test_a_title_without_a_unit_beside_an_unknown_title_names_both(tmp_path):
    with pytest.raises(REFUSED) as caught:
        read_measured(written(tmp_path, "a.csv", f"freq,re,a\n{COMPLEX_ROWS}"))
    assert "column 're' has no unit" in caught.value.message
    assert "'a'" in caught.value.message
    text = f"{advised_header(caught.value)}\n{COMPLEX_ROWS}"
    assert read_measured(written(tmp_path, "b.csv", text)).Y[:, 0, 0] == pytest.approx(Y, rel=1e-6)
