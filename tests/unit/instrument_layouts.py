"""Files in the layouts of instruments, written from one circuit: a resonance near 40 kHz.

Each layout is a file name, its text, and whether its numbers have few digits. Sources of the
layouts are listed in ``tests/data/instruments/README.md``.
"""

from dataclasses import dataclass

import numpy as np

F = np.linspace(36e3, 44e3, 101)
W = 2 * np.pi * F
# 8 Ohm in series with 4 nF beside 150 Ohm, 12.5 mH and 1.4 nF
Z = 8 + 1 / (1j * W * 4e-9 + 1 / (150 + 1j * W * 12.5e-3 + 1 / (1j * W * 1.4e-9)))
Y = 1 / Z
S = (Z - 50) / (Z + 50)
SHUNT = 330.0
GAIN = SHUNT / (Z + SHUNT)
DEG = np.angle(Z, deg=True)
ZERO = np.zeros(len(F))


@dataclass(frozen=True)
class Layout:
    """A file: its name, the lines above the numbers, the columns, and what is between them."""

    name: str
    head: str
    columns: tuple
    separator: str = ","
    form: str = "{:.9g}"
    tail: str = ""
    shunt: float | None = None

    @property
    def text(self) -> str:
        return self.head + self.rows() + self.tail

    def rows(self) -> str:
        return rows(*self.columns, separator=self.separator, form=self.form)


def rows(*columns, separator=",", form="{:.9g}"):
    lines = zip(*columns, strict=True)
    return "".join(separator.join(form.format(x) for x in line) + "\n" for line in lines)


E4990 = "!Keysight Technologies,E4990A,MY00000000,A.02.12\n!Date: x\n\nBEGIN CH1_DATA\n"
TRACE_A = '"TRACE: A"\n"FORMAT: |Z|"\n"Frequency"\t"Data Trace Real"\t"Data Trace Imag"\n'
TRACE_B = '\n"TRACE: B"\n"FORMAT: theta(deg)"\n"Frequency"\t"Data Trace Real"\t"Data Trace Imag"\n'
PARAMETERS = '4294A REV1.11\n"DATE: x"\n\n"MEASURE PARAMETER: {}"\n"SWEEP TYPE: LIN FREQ"\n\n'
SCALES = [
    trace.replace("|Z|", "LOG").replace("theta(deg)", "LINEAR") for trace in (TRACE_A, TRACE_B)
]
ZPLOT = "  Freq(Hz)    Ampl     Bias   Time(Sec)   Z'(a)    Z''(b)    GD   Err   Range"
AD2 = "#Digilent WaveForms Impedance Analyzer\n#Device Name: Discovery2\n#Serial Number: SN\n#\n"
BODE = (
    'Frequency (Hz);"Trace 1: Gain: Real ";"Trace 1: Gain: Imaginary ";'
    'Trace 1: Gain: Magnitude (dB);"Trace 2: Gain: Real ";"Trace 2: Gain: Imaginary ";'
    "Trace 2: Gain: Phase (°)\n"
)
GAIN_COLUMNS = (F, GAIN.real, GAIN.imag, 20 * np.log10(abs(GAIN)), GAIN.real, GAIN.imag,
                np.angle(GAIN, deg=True))  # fmt: skip
Q = abs(Z.imag / Z.real)
PANDAS = "".join(
    f"{k:<4d} {f:10.1f} {z.real:14.6f} {z.imag:14.6f}\n"
    for k, (f, z) in enumerate(zip(F, Z, strict=True))
)

LAYOUTS = {
    "E4990A, R and X": Layout(
        "a.csv", E4990 + "Frequency(Hz), R(Ohm)-data, X(Ohm)-data\n", (F, Z.real, Z.imag), ", ",
        "{:+.11e}", "END\n"),
    "E4990A, memory trace": Layout(
        "a.csv", E4990 + "Title label, TEST DATA\nDCV(V), +5.230e-005, DCI(A), +2.335e-005\n"
        "Frequency(Hz), |Z|(Ohm)-data, theta-z(deg)-data, theta-z(deg)-mem\n",
        (F, abs(Z), DEG, DEG + 20), ", ", "{:+.11e}", "END\n"),
    "E4990A, Z-Real": Layout(
        "a.csv", E4990 + "Frequency(Hz), Z-Real(Ohm)-data, Z-Imag(Ohm)-data, Y-Real(S)-mem\n",
        (F, Z.real, Z.imag, Y.real), ", ", "{:+.11e}", "END\n"),
    "E4990A, Ls and Rs": Layout(
        "a.csv", E4990 + "Frequency(Hz), Ls(H)-data, Rs(Ohm)-data\n", (F, Z.imag / W, Z.real), ", ",
        "{:+.11e}", "END\n"),
    "4294A, two traces": Layout(
        "a.txt", '"4294A REV1.11"\n"DATE: 1999"\n\n' + TRACE_A, (F, abs(Z), ZERO), "\t", "{:.9e}",
        TRACE_B + rows(F, DEG, ZERO, separator="\t", form="{:.9e}")),
    "4294A, table": Layout("a.csv", TRACE_A, (F, abs(Z), DEG), "\t"),
    "4294A, complex": Layout(
        "a.txt", TRACE_A.replace("|Z|", "COMPLEX Z"), (F, Z.real, Z.imag), "\t", "{:.9e}"),
    "4294A, scales of two traces": Layout(
        "a.txt", PARAMETERS.format("IMPEDANCE MAG PHASE (DEG)") + SCALES[0], (F, abs(Z), ZERO),
        "\t", "{:.9e}", SCALES[1] + rows(F, DEG, ZERO, separator="\t", form="{:.9e}")),
    "4294A, Cs and Rs": Layout(
        "a.txt", PARAMETERS.format("CS-RS") + SCALES[0], (F, -1 / (W * Z.imag), ZERO),
        "\t", "{:.9e}", SCALES[1] + rows(F, Z.real, ZERO, separator="\t", form="{:.9e}")),
    "E5061B, Touchstone": Layout(
        "a.s1p", "!Keysight Technologies,E5061B,MY00000000,A.03.20\n!Date: x\n!Freq S11\n"
        "# Hz S DB R 50\n", (F, 20 * np.log10(abs(S)), np.angle(S, deg=True)), "\t"),
    "PNA, real and imaginary": Layout(
        "a.csv", "!CSV A.01.01\n!Keysight,N5247B\n\nBEGIN CH1_DATA\nFreq(Hz),S11(REAL),S11(IMAG)\n",
        (F, S.real, S.imag), tail="END\n"),
    "PNA, log magnitude": Layout(
        "a.csv", "!CSV A.01.01\n\nBEGIN CH1_DATA\nFreq(Hz),S11 Log Mag(dB),S11 Phase(deg)\n",
        (F, 20 * np.log10(abs(S)), np.angle(S, deg=True)), tail="END\n"),
    "PNA, linear magnitude": Layout(
        "a.csv", "!CSV A.01.01\n\nBEGIN CH1_DATA\nFreq(Hz),S11 Lin Mag(U),S11 Phase(deg)\n",
        (F, abs(S), np.angle(S, deg=True)), tail="END\n"),
    "ZNB": Layout("a.csv", "freq[Hz];re:Trc1_S11;im:Trc1_S11;\n", (F, S.real, S.imag), ";"),
    "Bode 100, new": Layout(
        "a.csv", "Frequency (Hz),Trace 1: Impedance: Magnitude (Ω),Trace 2: Impedance: Phase (°)\n",
        (F, abs(Z), DEG)),
    "Bode 100, old": Layout(
        "a.csv", "---Measurement Setup---\nDevice Type: Bode100R2\nSweep Mode: Linear\n-----\n"
        "Frequency (Hz),TR2: Impedance (Real),TR2: Impedance (Imag),TR2: Impedance (Ls)\n",
        (F, Z.real, Z.imag, Z.imag / W)),
    "Bode 100, absolut": Layout(
        "a.csv", "---Measurement Setup---\nDevice Type: Bode100\n-----\n"
        "Frequency (Hz),TR1: Impedance (absolut),TR2: Impedance (Degree)\n", (F, abs(Z), DEG)),
    "Bode 100, gain": Layout("a.csv", BODE, GAIN_COLUMNS, ";", shunt=SHUNT),
    "Hioki": Layout(
        "a.csv", "IM3570\nNo,1\nFREQUENCY[Hz],Z[ohm],PHASE[deg]\n", (F, abs(Z), DEG)),
    "Hioki, numbered": Layout(
        "a.csv", '"HIOKI IM7581"\n"DATE","20-01-01"\n"No.","FREQ[Hz]","Z[ohm]","PHASE[deg]"\n',
        (np.arange(1, len(F) + 1), F, abs(Z), DEG)),
    "Hioki, Cs and D": Layout(
        "a.csv", "FREQ[Hz],Cs[F],D[]\n", (F, -1 / (W * Z.imag), -Z.real / Z.imag)),
    "Wayne Kerr": Layout(
        "a.csv", "Frequency (Hz),Impedance (O),Angle (°)\n", (F, abs(Z), DEG), ", "),
    "Analog Discovery": Layout(
        "a.csv", AD2 + "Frequency (Hz),Trace th (deg),Trace |Z| (Ohm),Trace Rs (Ohm),"
        "Trace Xs (Ohm)\n",
        (F, DEG, abs(Z), Z.real, Z.imag)),
    "Analog Discovery, old": Layout(
        "a.csv", AD2 + "Frequency (Hz),Trace θ (deg),Trace |Z| (Ω),Trace Rs (Ω),Trace Xs (Ω)\n",
        (F, DEG, abs(Z), Z.real, Z.imag)),
    "Analog Discovery, gain": Layout(
        "a.csv", "#Digilent WaveForms Network Analyzer - Bode\n#Device Name: Discovery2\n"
        "Frequency (Hz),Channel 1 Magnitude (dB),Channel 2 Magnitude (dB),Channel 2 Phase (deg)\n",
        (F, F / 1e6, 20 * np.log10(abs(GAIN)), np.angle(GAIN, deg=True)), shunt=SHUNT),
    "NanoVNA": Layout("a.s1p", "# HZ S RI R 50\n", (F, S.real, S.imag), " "),
    "REW": Layout(
        "a.txt", "* Impedance data measured by REW V5.20\n* Sense resistor: 100.0\n*\n"
        "* Freq(Hz) Z(ohms) Phase(degrees)\n", (F, abs(Z), DEG), " ", "{:.6f}"),
    "ARTA": Layout("a.zma", "", (F, abs(Z), DEG), "\t", "{:.6f}"),
    "DATS": Layout("a.zma", "* Freq(Hz)  Z(Ohms)  Phase(deg)\n", (F, abs(Z), DEG), " "),
    "CLIO": Layout(
        "a.zma", "*****\n* FILE:A.zma\n* Data: Impedance (ohms), Phase (degrees)\n*****\n",
        (F, abs(Z), DEG), "   ", "{:+.6f}"),
    "FRD through a shunt": Layout(
        "a.frd", "* made by hand\n", (F, 20 * np.log10(abs(GAIN)), np.angle(GAIN, deg=True)), " ",
        "{:.9g}", shunt=SHUNT),
    "oscilloscope gain": Layout(
        "a.csv", "in Sa,Frequency in Hz,Gain in dB,Phase in °,Amplitude in Vpp\n",
        (np.arange(len(F)), F, 20 * np.log10(abs(GAIN)), np.angle(GAIN, deg=True), ZERO + 1),
        shunt=SHUNT),
    "source over shunt": Layout(
        "a.csv", "Frequency (Hz),Gain (dB),Phase (deg)\n",
        (F, -20 * np.log10(abs(GAIN)), -np.angle(GAIN, deg=True)), shunt=SHUNT),
    "pandas, index": Layout(
        "a.csv", ",f_hz,R (Ohm),X (Ohm)\n", (np.arange(len(F)), F, Z.real, Z.imag)),
    "pandas, to_string": Layout("a.txt", "     f_hz R(Ohm) X(Ohm)\n" + PANDAS, (ZERO[:0],)),
    "pandas, complex": Layout(
        "a.csv", ",frequency (Hz),Z (Ohm)\n", (np.arange(len(F)), F, Z), form="{:.9g}"),
    "numpy, complex": Layout("a.txt", "# f_hz Z_ohm\n", (F + 0j, Z), " ", "({:.9e})"),
    "potentiostat": Layout("a.csv", "freq/Hz,Re(Z)/Ohm,-Im(Z)/Ohm\n", (F, Z.real, -Z.imag)),
    "potentiostat, ZPlot": Layout(
        "a.z", "ZPLOT2 ASCII\n  Date:      10-12-2018\n  Open Circuit Potential (V): 0.0033\n"
        + ZPLOT + "\n", (F, ZERO, ZERO, F, Z.real, Z.imag, ZERO, ZERO, ZERO), "\t", "{:.9E}"),
    "potentiostat, ZPlot in quotes": Layout(
        "a.txt", f'"ZPlotW Data File: Version 3.2c"\n0,3,0,1,300000,0.005\n79\n"{ZPLOT}"\n',
        (F, ZERO, ZERO, F, Z.real, Z.imag, ZERO, ZERO, ZERO), ", ", "{:.9E}"),
    "potentiostat, primes": Layout(
        "a.txt", "A.C. Impedance\nInstrument Model:  CHI660E\n\nInit E (V) = 0\n\n"
        "Freq/Hz, Z'/ohm, Z\"/ohm, Z/ohm, Phase/deg\n\n", (F, Z.real, Z.imag, abs(Z), DEG), ", ",
        "{:.9e}"),
    "potentiostat, double prime at the end": Layout(
        "a.txt", "Freq\tZ'\tZ\"\n", (F, Z.real, Z.imag), "\t"),
    "potentiostat, rows of direct current": Layout(
        "a.txt", "Potential (V)\tElapsed Time (s)\tFrequency (Hz)\tZre (ohms)\tZimg (ohms)\n"
        "3.49\t10\t0\t0\t0\n3.48\t20\t0\t0\t0\n", (ZERO + 3, F, F, Z.real, Z.imag), "\t"),
    "primes of Y": Layout("a.csv", "f_hz,Y' (S),Y'' (S)\n", (F, Y.real, Y.imag)),
    "G and B": Layout("a.csv", "Freq(Hz),G(S),B(S)\n", (F, Y.real, Y.imag)),
    "Cs and Rs": Layout("a.csv", "Freq(Hz),Cs(F),Rs(Ohm)\n", (F, -1 / (W * Z.imag), Z.real)),
    "Cp and Rp": Layout("a.csv", "Freq(Hz),Cp(F),Rp(Ohm)\n", (F, Y.imag / W, 1 / Y.real)),
    "Cp and G": Layout("a.csv", "Freq(Hz),Cp(F),G(S)\n", (F, Y.imag / W, Y.real)),
    "Cp and D": Layout("a.csv", "Freq(Hz),Cp(F),D\n", (F, Y.imag / W, Y.real / Y.imag)),
    "Lp and Q": Layout("a.csv", "Freq(Hz),Lp(H),Q\n", (F, -1 / (W * Y.imag), -Y.imag / Y.real)),
}  # fmt: skip
