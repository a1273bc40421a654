"""Tables of instruments, their units and signs, against the circuit that their numbers follow."""

import numpy as np
import pytest
import skrf
from support import app, read_measured, reduce_file
from typer.testing import CliRunner

import kc2spice as kc

F = np.linspace(1e3, 1e5, 400)
W = 2 * np.pi * F
# 5 Ohm in series with 2 nF parallel to 20 Ohm, 5 mH and 5 nF
Z = 5 + 1 / (1j * W * 2e-9 + 1 / (20 + 1j * W * 5e-3 + 1 / (1j * W * 5e-9)))
Y = 1 / Z
S = (Z - 50) / (Z + 50)
PART = Z - 5  # parallel branches describe it exactly
ANGLE = np.angle(Z, deg=True)
Q = np.abs(Z.imag / Z.real)


def lines(*columns, separator=",", form="{:.12g}"):
    return "".join(
        separator.join(form.format(x) for x in row) + "\n" for row in zip(*columns, strict=True)
    )


LAYOUTS = {
    "angular.csv": ("frequency (rad/s),R,X\n", (W, Z.real, Z.imag), ","),
    "omega.csv": ("omega,R [Ohm],X [Ohm]\n", (W, Z.real, Z.imag), ","),
    "millihertz.csv": ("Frequency(mHz),|Z|(Ohm),Phase(deg)\n", (1e3 * F, abs(Z), ANGLE), ","),
    "megahertz.csv": ("FREQ(MHZ),|Z|(mOhm),Phase(rad)\n",
                      (F / 1e6, 1e3 * abs(Z), np.angle(Z)), ","),
    "minus.csv": ("freq/Hz,Re(Z)/Ohm,-Im(Z)/Ohm\n", (F, Z.real, -Z.imag), ","),
    "minus_word.csv": ("freq (Hz),Zreal (ohm),-Zimag (ohm)\n", (F, Z.real, -Z.imag), ","),
    "primes.txt": ("f/Hz;Z'/kOhm;-Z''/kOhm\n", (F, Z.real / 1e3, -Z.imag / 1e3), ";"),
    "minus_phase.csv": ("f_hz,z_ohm,-phase_deg\n", (F, abs(Z), -ANGLE), ","),
    "of_y.csv": ("f_hz,|Y| (mS),Yphase (deg)\n", (F, 1e3 * abs(Y), -ANGLE), ","),
    "of_both.csv": ("f_hz,|Y| (mS),theta-z (deg)\n", (F, 1e3 * abs(Y), ANGLE), ","),
    "real_of_y.csv": ("f_hz,real (S),imag (S)\n", (F, Y.real, Y.imag), ","),
    "index.csv": ("IM3570\nNo,1\nIndex,FREQUENCY[Hz],Z[ohm],PHASE[deg]\n",
                  (np.arange(400), F, abs(Z), ANGLE), ","),
    "traces.csv": ("---Setup---\nFrequency (Hz),Trace 1: Impedance: Magnitude (Ω),"
                   "Trace 2: Impedance: Phase (°)\n", (F, abs(Z), ANGLE), ","),
    "suffix.csv": ("!Maker,MODEL\n\nBEGIN CH1_DATA\nFrequency(Hz), R(Ohm)-data, X(Ohm)-data\n",
                   (F, Z.real, Z.imag), ","),
    "words.csv": ("Freq [Hz];Impedance |Z| [Ohm];Impedance Phase [deg]\n", (F, abs(Z), ANGLE), ";"),
    "blanks.txt": ("* Freq [Hz]  Impedance |Z| [Ohm]  Impedance Phase [deg]\n",
                   (F, abs(Z), ANGLE), " "),
    "speaker.zma": ("* Freq(Hz)  Z(Ohms)  Phase(deg)\n", (F, abs(Z), ANGLE), " "),
    "units_below.tsv": ("Frequency\tZ\tPhase\nkHz\tkOhm\tdeg\n",
                        (F / 1e3, abs(Z) / 1e3, ANGLE), "\t"),
    "cs.csv": ("Freq(Hz),Cs(nF),Rs(Ohm)\n", (F, -1e9 / (W * Z.imag), Z.real), ","),
    "ls.csv": ("Freq(Hz),Ls(H),Rs(Ohm)\n", (F, Z.imag / W, Z.real), ","),
    "cp.csv": ("Freq(Hz),Cp(pF),Rp(Ohm)\n", (F, 1e12 * Y.imag / W, 1 / Y.real), ","),
    "lp.csv": ("Freq(Hz),Lp(mH),G(uS)\n", (F, -1e3 / (W * Y.imag), 1e6 * Y.real), ","),
    "cs_d.csv": ("Freq(Hz),Cs(F),D\n", (F, -1 / (W * Z.imag), -Z.real / Z.imag), ","),
    "ls_q.csv": ("Freq(Hz),Ls(H),Q\n", (F, Z.imag / W, Z.imag / Z.real), ","),
    "cp_q.csv": ("Freq(Hz),Cp(F),Q\n", (F, Y.imag / W, Y.imag / Y.real), ","),
    "s11.csv": ("frequency_hz,s11_db,s11_deg\n",
                (F, 20 * np.log10(abs(S)), np.angle(S, deg=True)), ","),
    "s11_parts.csv": ("frequency_hz,s11_re,s11_im\n", (F, S.real, S.imag), ","),
    "two_options.s1p": ("# Hz S RI R 50\n# kHz S RI R 50\n", (F, S.real, S.imag), " "),
    "terahertz.s1p": ("# THz S RI R 50\n", (F / 1e12, S.real, S.imag), " "),
}  # fmt: skip


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_is_the_same_circuit(tmp_path, name):
    head, columns, separator = LAYOUTS[name]
    path = tmp_path / name
    path.write_text(head + lines(*columns, separator=separator), encoding="utf-8")
    found = read_measured(path)
    assert found.f == pytest.approx(F, rel=1e-9)
    assert found.Y[:, 0, 0] == pytest.approx(Y, rel=1e-7)


def test_commas_between_thousands_and_before_decimals(tmp_path):
    """Grouped frequencies beside decimal points, decimal commas, and a comma of either meaning."""
    path = tmp_path / "thousands.tsv"
    rows = "".join(
        f"{f:,.0f}\t{z.real:.6f}\t{z.imag:.6f}\n" for f, z in zip(F[::10], Z[::10], strict=True)
    )
    path.write_text("f\tR\tX\n" + rows)
    assert read_measured(path).f == pytest.approx(np.round(F[::10]), rel=1e-12)
    quoted = tmp_path / "quoted.csv"
    quoted.write_text(
        "f,R,X\n" + "".join(f'"{a}",{b},{c}\n' for a, b, c in map(str.split, rows.splitlines()))
    )
    assert read_measured(quoted).f == pytest.approx(np.round(F[::10]), rel=1e-12)
    spaced = tmp_path / "spaced.csv"
    spaced.write_text("f;R;X\n" + rows.replace(",", " ").replace("\t", ";"))
    assert read_measured(spaced).f == pytest.approx(np.round(F[::10]), rel=1e-12)
    decimal = tmp_path / "decimal.csv"
    decimal.write_text("f;R;X\n" + lines(F, Z.real, Z.imag, separator=";").replace(".", ","))
    assert read_measured(decimal).Y[:, 0, 0] == pytest.approx(Y, rel=1e-7)
    doubtful = tmp_path / "doubtful.csv"
    doubtful.write_text("f;R;X\n" + "".join(f"{k},125;{k},250;{k},375\n" for k in range(1, 30)))
    with pytest.raises(kc.errors.UsageError, match=r"column 'f': '1,125' has a comma that can"):
        read_measured(doubtful)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("freq (mhz),R (Ohm),X (Ohm)", "'mhz' may mean MHz or mHz"),
        ("freq (rpm),R (Ohm),X (Ohm)", "'freq .rpm.'|'rpm' is no unit"),
        ("freq (Hz),R (deg),X (Ohm)", r"column 'R \(deg\)': 'deg' is not a unit of impedance"),
        ("freq (Hz),Trace A Real,Trace A Imag", "unknown columns: 'Trace A Real', 'Trace A Imag'"),
        ("freq (Hz),s11,phase (deg)", "column 's11' has no unit"),
        ("freq (Hz),R (Ohm)", "separated like the 3 columns"),
        ("freq (Hz),Cp (MF),D", "milli or mega"),
    ],
)
def test_ambiguous_columns_are_rejected_by_name(tmp_path, header, words):
    path = tmp_path / "doubtful.csv"
    path.write_text(header + "\n" + lines(F, Z.real, Z.imag))
    with pytest.raises(kc.errors.UsageError, match=words):
        read_measured(path)


def test_words_of_an_option_line_are_known_or_refused(tmp_path):
    path = tmp_path / "unit.s1p"
    path.write_text("# DHz S RI R 50\n" + lines(F, S.real, S.imag, separator=" "))
    with pytest.raises(kc.errors.UsageError, match="'dhz', which is unknown"):
        read_measured(path)


@pytest.mark.parametrize("ports", [1, 2])
def test_impedances_of_touchstone_1_are_normalised(tmp_path, ports):
    """``Z / R`` and ``Y R`` stand in the file: by their definition, and as scikit-rf reads it."""
    shape = np.array([[1.0]]) if ports == 1 else np.array([[1.0, 0.2], [0.2, 0.5]])
    matrix = Z[:, None, None] * shape
    f = F[:, None]
    for kind, values in (("Z", matrix / 75.0), ("Y", np.linalg.inv(matrix) * 75.0)):
        flat = values.swapaxes(1, 2).reshape(len(F), -1)  # 11, 21, 12, 22
        columns = np.column_stack([f, np.stack([flat.real, flat.imag], 2).reshape(len(F), -1)])
        path = tmp_path / f"{kind}.s{ports}p"
        path.write_text(f"# Hz {kind} RI R 75\n" + lines(*columns.T, separator=" "))
        found = read_measured(path)
        assert np.abs(found.Y @ matrix - np.eye(ports)).max() < 1e-8
        if kind == "Z":  # scikit-rf 1 multiplies Y by R once more
            other = skrf.Network(str(path))
            assert np.abs(found.Y - other.y).max() < 1e-8 * np.abs(other.y).max()
        second = tmp_path / f"{kind}.ts"  # version 2 states them in Ohm and S
        plain = matrix if kind == "Z" else np.linalg.inv(matrix)
        flat = plain.reshape(len(F), -1)
        columns = np.column_stack([f, np.stack([flat.real, flat.imag], 2).reshape(len(F), -1)])
        order = "[Two-Port Data Order] 12_21\n" if ports == 2 else ""
        second.write_text(
            f"[Version] 2.0\n# Hz {kind} RI R 75\n[Number of Ports] {ports}\n{order}"
            f"[Number of Frequencies] {len(F)}\n[Network Data]\n"
            + lines(*columns.T, separator=" ")
            + "[End]\n"
        )
        assert np.abs(read_measured(second).Y @ matrix - np.eye(ports)).max() < 1e-8


def test_noise_is_that_of_the_measured_quantity(tmp_path):
    """Additive noise of S, relative noise of Z; what they do to Y against repeated measurements."""
    random = np.random.default_rng(4)

    def noise(*shape):
        return random.normal(size=shape) + 1j * random.normal(size=shape)

    path = tmp_path / "s.s1p"
    noisy = S + 1e-3 * noise(400)
    path.write_text("# Hz S RI R 50\n" + lines(F, noisy.real, noisy.imag, separator=" "))
    found = read_measured(path)
    assert found.quantity == "S"
    assert found.estimated_noise == pytest.approx(1e-3, rel=0.15)
    many = S + 1e-5 * noise(2000, 400)
    spread = np.std(((1 - many) / (1 + many)).real, axis=0) / 50 / 1e-5
    assert found.admittance_noise[:, 0, 0] / found.estimated_noise == pytest.approx(spread, rel=0.3)
    path = tmp_path / "z.csv"
    noisy = Z * (1 + 1e-3 * noise(400))
    path.write_text("f_hz,r_ohm,x_ohm\n" + lines(F, noisy.real, noisy.imag))
    found = read_measured(path)
    assert found.estimated_noise == pytest.approx(1e-3, rel=0.15)
    assert found.noise == pytest.approx(found.estimated_noise, rel=1e-6)
    f = F[:60]
    two = 50 * np.array([[1.0, 0.3], [0.3, 2.0]]) + 1j * f[:, None, None] * np.eye(2) * 1e-3
    S2 = skrf.network.z2s(two, 50.0)
    path = tmp_path / "two.s2p"
    skrf.Network(f=f, s=S2, z0=50, f_unit="hz").write_touchstone(str(path), form="ri")
    found = read_measured(path)
    many = skrf.network.s2y(np.tile(S2[:1], (4000, 1, 1)) + 1e-5 * noise(4000, 2, 2), 50.0)
    spread = np.std(many.real, axis=0) / 1e-5 * found.estimated_noise
    assert found.admittance_noise[0] == pytest.approx(spread, rel=0.1)


def test_the_command_prints_its_interpretation_of_the_file(tmp_path):
    path = tmp_path / "part.csv"
    path.write_text("f,R (Ohm),-X (Ohm)\n" + lines(F, PART.real, -PART.imag))
    done = CliRunner().invoke(app, ["reduce", str(path), "-o", str(tmp_path / "out")])
    assert done.exit_code == 0
    text = " ".join(done.output.split())
    for words in ("f [Hz] from 'f'", "-X [Ohm] from '-X (Ohm)'", "400 points from 1000 to 100000"):
        assert words in text
    assert "note: f: no unit; Hz is assumed" in text


def test_a_misfit_beyond_noise_ends_without_a_model(tmp_path):
    """Noise in S of a part far from 50 Ohm: its antiresonance is lost in the noise."""
    random = np.random.default_rng(0).normal(size=(2, 400))
    far = 1 / (1j * W * 2e-10 + 1 / (400 + 1j * W * 5e-2 + 1 / (1j * W * 5e-10)))
    noisy = (far - 50) / (far + 50) + 5e-3 * (random[0] + 1j * random[1])
    path = tmp_path / "noisy.s1p"
    path.write_text("# Hz S RI R 50\n" + lines(F, noisy.real, noisy.imag, separator=" "))
    done = CliRunner().invoke(app, ["reduce", str(path), "-o", str(tmp_path / "out")])
    assert done.exit_code == 4, done.output
    assert not (tmp_path / "out").exists()


def test_a_misfit_above_a_percent_warns(tmp_path):
    random = np.random.default_rng(0).normal(size=(2, 400))
    noisy = PART * (1 + 4e-3 * (random[0] + 1j * random[1]))
    path = tmp_path / "noisy.csv"
    path.write_text("f_hz,r_ohm,x_ohm\n" + lines(F, noisy.real, noisy.imag))
    found = reduce_file(path, tmp_path / "out")
    assert 0.01 < found["error_estimate"] < 0.03
    assert len(found["warnings"]) == 1
    path.write_text("f_hz,r_ohm,x_ohm\n" + lines(F, PART.real, PART.imag))
    assert not reduce_file(path, tmp_path / "out")["warnings"]
