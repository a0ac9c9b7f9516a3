"""A program written against the public names, linked dynamically and statically; all names are exported."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from serve.native.conftest import ServedFile

PROGRAM = """
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <drdc.h>

int main()
{
    double p[3], R[3][3];
    if (drdOpen() < 0 || !drdIsInitialized() || drdAutoInit() < 0) {
        std::printf("%s\\n", dhdErrorGetLastStr());
        return 1;
    }
    dhdSetTimeGuard(0);
    dhdEnableForce(DHD_ON);
    dhdGetPositionAndOrientationFrame(&p[0], &p[1], &p[2], R);
    std::printf("%s %d %.4f %.4f %.4f %.1f\\n", dhdGetSystemName(), dhdGetSystemType(), p[0], p[1], p[2], R[2][2]);
    int worst = 0;
    for (int i = 0; i < 200; i++) {
        double depth = 0.01 - std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
        double size = std::fmax(depth, 0.0) * 50.0;
        worst = std::max(worst, std::abs(dhdSetForceAndTorqueAndGripperForce(0, 0, size, 0, 0, 0, 0)));
        dhdGetPosition(&p[0], &p[1], &p[2]);
        dhdSleep(0.001);
    }
    std::printf("%d\\n", worst);
    std::fflush(stdout);
    std::getchar();
    return drdClose();
}
"""


@pytest.mark.parametrize("kind", ["dynamic", "static"])
def test_a_program_in_c_plus_plus(served: ServedFile, libraries: Path, tmp_path: Path, kind: str) -> None:
    if shutil.which("c++") is None:
        pytest.skip("c++ is not installed (Debian: apt-get install g++)")
    source, binary = tmp_path / "sphere.cpp", tmp_path / "sphere"
    source.write_text(PROGRAM)
    library = ["-ldrd"] if kind == "dynamic" else [str(libraries / "libdrd.a"), "-pthread", "-lm"]
    build = ["c++", "-Wall", "-Wextra", "-Werror", source, "-o", binary, f"-I{libraries.parent / 'include'}"]
    subprocess.run([*build, f"-L{libraries}", *library], check=True)
    rest = served.loop.device.shell.contact_distance  # type: ignore[union-attr]
    served.publish(p=(0.0, 0.0, rest + 0.006))
    environment = {**os.environ, **served.run}
    if kind == "dynamic":
        environment["LD_LIBRARY_PATH"] = str(libraries)
    with subprocess.Popen(
        [binary], env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        session = served.await_force((0.0, 0.0, 50.0 * 0.004), 10.0)
        said = process.communicate("\n", timeout=30)[0].splitlines()
    assert process.returncode == 0
    assert said == ["haptorb omni 34 0.0000 0.0000 0.0060 1.0", "0"]
    assert session > 0


def defined(library: Path, pattern: str) -> set[str]:
    said = subprocess.run(["nm", "-D", "--defined-only", library], capture_output=True, text=True, check=True).stdout
    names = {line.split()[2] for line in said.splitlines() if line.split()[1] in "TBDR"}
    assert all(re.match(pattern, one) for one in names), f"names that are none of the interface: {names}"
    return names


def test_every_declared_name_is_there(libraries: Path) -> None:
    """And no other: the libraries' inner names stay their own."""
    headers = libraries.parent / "include"
    dhd, drd, hd = (
        set(re.findall(pattern, (headers / name).read_text()))
        for name, pattern in (
            ("dhdc.h", r"\b(dhd[A-Z]\w+)\("), ("drdc.h", r"\b(drd[A-Z]\w+)\("), ("HD/hd.h", r"\b(hd[A-Z]\w+)\("),
        )
    )  # fmt: skip
    assert defined(libraries / "libdrd.so.3", "d[hr]d[A-Z]") == dhd | drd
    assert defined(libraries / "libHD.so.3.4", "hd[A-Z]") == hd
    assert (len(dhd), len(drd), len(hd)) == (167, 67, 34)
    static = subprocess.run(
        ["nm", "-g", "--defined-only", libraries / "libdrd.a"], capture_output=True, text=True, check=True
    )
    assert set(re.findall(r"^\w+ T (\w+)$", static.stdout, re.MULTILINE)) == dhd | drd


#: numbers and macros that CHAI3D 3.2's device class and ROS' drivers of the Touch name beside the functions
NAMES = """
#include <HD/hd.h>
#include <drdc.h>
static_assert(DHD_DEVICE_3DOF == 31 && DHD_DEVICE_OMEGA == 32 && DHD_DEVICE_OMEGA3 == 33 && DHD_DEVICE_OMEGA33 == 34);
static_assert(DHD_DEVICE_OMEGA331 == 35 && DHD_DEVICE_OMEGA33_LEFT == 36 && DHD_DEVICE_OMEGA331_LEFT == 37);
static_assert(DHD_DEVICE_FALCON == 60 && DHD_DEVICE_6DOF == 61 && DHD_DEVICE_6DOF_500 == 62);
static_assert(DHD_DEVICE_DELTA3 == 63 && DHD_DEVICE_DELTA6 == 64 && DHD_DEVICE_SIGMA33P == 106);
static_assert(DHD_DEVICE_SIGMA33P_LEFT == 107 && DHD_DEVICE_SIGMA331 == 104 && DHD_DEVICE_SIGMA331_LEFT == 105);
static_assert(DHD_MAX_DOF == 8 && DHD_ON == 1 && DHD_OFF == 0 && DHD_TIMEGUARD == 1 && DHD_MAX_DEVICE >= 4);
HDCallbackCode HDCALLBACK call(void *) { return HD_CALLBACK_DONE; }
int main()
{
    HDErrorInfo error;
    hdInitDevice(HD_DEFAULT_DEVICE);
    if (HD_DEVICE_ERROR(error = hdGetError()))
        return error.errorCode == HD_DEVICE_FAULT ? 0 : 1;
    hdScheduleAsynchronous(call, nullptr, HD_MAX_SCHEDULER_PRIORITY);
    return 2;
}
"""


def test_numbers_and_macros_of_programs(libraries: Path, tmp_path: Path) -> None:
    """They compile as such programs name them; without a device the macro sees the fault."""
    if shutil.which("c++") is None:
        pytest.skip("c++ is not installed (Debian: apt-get install g++)")
    source, binary = tmp_path / "names.cpp", tmp_path / "names"
    source.write_text(NAMES)
    headers = f"-I{libraries.parent / 'include'}"
    subprocess.run(["c++", "-std=c++17", source, "-o", binary, headers, f"-L{libraries}", "-lHD"], check=True)
    environment = {**os.environ, "LD_LIBRARY_PATH": str(libraries), "HAPTORB_RUN": str(tmp_path / "none.device")}
    assert subprocess.run([binary], env=environment, stderr=subprocess.DEVNULL, check=False).returncode == 0


#: what CHAI3D's device class for Force Dimension calls
CHAI3D = """
drdOpenID drdClose drdStop drdIsInitialized drdAutoInit dhdOpenID dhdClose dhdGetDeviceCount dhdGetDeviceID
dhdGetSystemType dhdEnableSimulator dhdIsLeftHanded dhdReset dhdEnableForce dhdSetForce dhdSetTorque
dhdSetForceAndTorque dhdSetForceAndGripperForce dhdSetForceAndTorqueAndGripperForce dhdGetPosition
dhdGetLinearVelocity dhdGetOrientationRad dhdGetOrientationFrame dhdGetGripperAngleRad dhdGetGripperThumbPos
dhdGetGripperFingerPos dhdGetButton dhdGetButtonMask dhdSetVibration dhdSetWatchdog dhdSetVelocityThreshold dhdPreset
dhdSetMot dhdSetJointTorques dhdGetEnc dhdGetEncVelocities dhdGetJointAngles dhdGetDeltaJacobian dhdGetWristJacobian
dhdJointAnglesToGravityJointTorques dhdSetBaseAngleZDeg dhdSetDeviceAngleDeg dhdEnableExpertMode
dhdDisableExpertMode
"""


def test_what_chai3d_calls_is_there(libraries: Path) -> None:
    assert set(CHAI3D.split()) <= defined(libraries / "libdrd.so.3", "d[hr]d[A-Z]")
