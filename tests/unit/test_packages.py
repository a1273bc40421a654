"""The install command is that of the operating system."""

import sys

import pytest
from support import doctor, install_commands

# First lines of /etc/os-release of several systems.
DEBIAN = 'PRETTY_NAME="Debian GNU/Linux 12 (bookworm)"\nID=debian\n'
MINT = 'NAME="Linux Mint"\nID=linuxmint\nID_LIKE="ubuntu debian"\n'
FEDORA = "NAME=Fedora\nID=fedora\n"
ROCKY = 'NAME="Rocky Linux"\nID="rocky"\nID_LIKE="rhel centos fedora"\n'
ARCH = "ID=arch\n"


@pytest.fixture
def system(monkeypatch, tmp_path):
    """Give this machine another platform and another /etc/os-release."""

    def change(platform, release=None):
        path = tmp_path / "os-release"
        if release is not None:
            path.write_text(release)
        monkeypatch.setattr(sys, "platform", platform)
        monkeypatch.setattr(install_commands, "_OS_RELEASE", path)

    return change


@pytest.mark.parametrize(
    ("platform", "release", "command"),
    [
        ("linux", DEBIAN, "apt-get install ngspice libngspice0"),
        ("linux", MINT, "apt-get install ngspice libngspice0"),
        ("linux", FEDORA, "dnf install ngspice libngspice"),
        ("linux", ROCKY, "dnf install ngspice libngspice"),
        ("darwin", None, "brew install ngspice libngspice"),
        ("linux", ARCH, "install the package that Debian calls ngspice, libngspice0"),
        ("linux", None, "install the package that Debian calls ngspice, libngspice0"),
        ("win32", None, "install the package that Debian calls ngspice, libngspice0"),
    ],
)
def test_command_of_each_system(system, platform, release, command):
    system(platform, release)
    assert install_commands.make_install_command("ngspice", "libngspice0") == command


def test_windows_installs_ngspice_with_scoop(system):
    system("win32")
    command = install_commands.make_install_command("ngspice")
    assert command == "scoop bucket add extras; scoop install ngspice"


def test_every_library_of_the_mesher_has_a_package_on_fedora(system):
    system("linux", FEDORA)
    command = install_commands.make_install_command(*doctor._GMSH_LIBRARIES.values())
    assert command.startswith("dnf install mesa-libGLU ")
    assert len(command.split()) == 2 + len(doctor._GMSH_LIBRARIES)


def test_doctor_prints_the_command_of_this_system(system, monkeypatch, tmp_path):
    system("linux", FEDORA)
    monkeypatch.setenv("PATH", str(tmp_path))
    fixes = {finding.name: finding.fix for finding in doctor._check_ngspice()}
    doctor.find_ngspice.cache_clear()
    assert fixes["ngspice"] == "dnf install ngspice"
    assert fixes["XSPICE code models"] == "dnf install ngspice"
