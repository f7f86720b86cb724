"""docker-compose.yml and Dockerfile agree with the code; scripts/compose_check.sh runs them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from covinz import config, health, service, supervisor
from covinz.access.enrolment import LOCAL_HOSTS
from covinz.access.roster import Roster
from covinz.backup import KINDS
from covinz.bus import endpoints
from covinz.bus.settings import listening
from scripts.compose_check import environment

ROOT = Path(__file__).parents[2]
COMPOSE = ROOT / "docker-compose.yml"
SECURED = ROOT / "docker-compose.tls.yml"
# Installed by requirements.txt; reading a file needs no engine.
PROGRAM = Path(sys.executable).with_name("docker-compose")
DOCKERFILE = (ROOT / "Dockerfile").read_text()
SPECS = supervisor.server_specs(Path("config.yaml"), Path("data"), workers=1)
SERVICES = {spec.argv[spec.argv.index("-m") + 1].removeprefix("services.") for spec in SPECS}

Json = dict[str, Any]


def compose(files: list[Path], *arguments: str, **environ: str) -> subprocess.CompletedProcess[str]:
    """Run compose on files, one on top of the other, with these variables only."""
    command = [str(PROGRAM), "--env-file", "/dev/null"]
    command += [word for file in files for word in ("--file", str(file))]
    command += arguments
    return subprocess.run(command, env=environ, capture_output=True, text=True)


def resolved(*above: Path, **environ: str) -> Json:
    """docker-compose.yml, and what is put on top of it, as compose understands it."""
    options = ["--profile", "*", "config", "--no-env-resolution", "--format", "json"]
    done = compose([COMPOSE, *above], *options, **environ)
    assert done.returncode == 0, done.stderr
    made: Json = json.loads(done.stdout)
    return made


@pytest.fixture(scope="module")
def services() -> Json:
    """The server's processes: those that start by themselves."""
    found: Json = resolved()["services"]
    return {name: one for name, one in found.items() if "profiles" not in one}


@pytest.mark.parametrize("files", [[COMPOSE], [COMPOSE, SECURED]])
def test_compose_accepts_the_files(files: list[Path]) -> None:
    done = compose(files, "config", "--quiet")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_compose_would_notice_a_misspelt_key(tmp_path: Path) -> None:
    broken = tmp_path / "docker-compose.yml"
    broken.write_text(COMPOSE.read_text().replace("healthcheck:", "healthchek:", 1))
    done = compose([broken], "config", "--quiet")
    assert done.returncode != 0
    assert "healthchek" in done.stderr


def test_the_services_are_those_that_the_supervisor_starts(services: Json) -> None:
    assert services.keys() == SERVICES


@pytest.mark.parametrize("name", sorted(SERVICES))
def test_a_service_runs_its_process_and_is_asked_for_its_own_health(
    services: Json, name: str
) -> None:
    python, module = services[name]["command"][:2], services[name]["command"][2]
    assert (python, module) == (["python", "-m"], f"services.{name}")
    options = services[name]["command"][3:]
    data, instance = options[options.index("--data") + 1], options[options.index("--id") + 1]
    probe = ["CMD", "python", "-m", "covinz.health", name, "--id", instance]
    assert services[name]["healthcheck"]["test"] == probe
    # The probe gives its own answer before the engine gives up on it.
    assert float(services[name]["healthcheck"]["timeout"].removesuffix("s")) > health.TIMEOUT_S
    assert f"install -d -o covinz -g covinz {data}\n" in DOCKERFILE
    # Only what there are several of needs names that differ.
    assert ("{host}" in instance) == ("replicas" in services[name].get("deploy", {}))


def test_the_bus_is_where_the_router_listens(services: Json) -> None:
    settings = {name: found["environment"] for name, found in services.items()}
    endpoints = {name: config.load(None, env).bus.endpoint for name, env in settings.items()}
    (port,) = services["router"]["ports"]
    assert endpoints.pop("router") == f"tcp/0.0.0.0:{port['target']}"
    assert set(endpoints.values()) == {f"tcp/router:{port['target']}"}
    assert f"EXPOSE {port['target']}\n" in DOCKERFILE


def test_every_variable_of_a_container_means_something(services: Json) -> None:
    code = "".join(file.read_text() for file in (ROOT / "covinz").glob("*.py"))
    for found in services.values():
        for variable in found["environment"]:
            # Settings were checked with config.load above.
            assert variable.startswith(config.ENVIRONMENT_PREFIX) or f'"{variable}"' in code


def test_every_variable_of_the_file_is_documented() -> None:
    used = set(re.findall(r"\$\{(\w+)", COMPOSE.read_text() + SECURED.read_text()))
    assert len(used) > 3
    guide = (ROOT / "docs" / "deployment.md").read_text()
    assert [name for name in sorted(used) if f"`{name}`" not in guide] == []


def test_volumes_are_for_the_services_that_have_durable_files(services: Json) -> None:
    durable = {
        file.parent.name
        for file in (ROOT / "services").glob("*/*.py")
        if "DurableFile(" in file.read_text()
    }
    mounted = {
        name: [(volume["source"], volume["target"]) for volume in found.get("volumes", [])]
        for name, found in services.items()
    }
    assert {name for name, volumes in mounted.items() if volumes} == durable
    assert all(mounted[name] == [(name, "/data")] for name in durable)
    assert resolved()["volumes"].keys() == {*durable, "backup"}


def test_the_backup_sees_all_files_in_folders_of_their_own() -> None:
    found = resolved()["services"]["backup"]
    assert found["profiles"] == ["backup"]
    mounted = {volume["target"]: volume["source"] for volume in found["volumes"]}
    assert mounted.pop("/backup") == "backup"
    assert mounted == {f"/server/{name}": name for name in KINDS}
    made = DOCKERFILE.replace("\\\n", " ").split()
    assert {"/backup", *mounted} <= set(made)


def test_robots_reach_the_router_only_and_from_this_machine_unless_told(services: Json) -> None:
    assert [name for name, found in services.items() if "ports" in found] == ["router"]
    (port,) = services["router"]["ports"]
    assert (port["host_ip"], port["published"]) == ("127.0.0.1", "7447")
    variables = {"COVINZ_PORT": "8000", "COVINZ_WORKERS": "8"}
    told = resolved(COVINZ_INSECURE_LISTEN="0.0.0.0", **variables)["services"]
    (port,) = told["router"]["ports"]
    assert (port["host_ip"], port["published"], port["target"]) == ("0.0.0.0", "8000", 7447)
    assert told["loop_solver"]["deploy"]["replicas"] == 8


def test_in_the_clear_only_the_router_says_that_it_may(services: Json) -> None:
    insecure = {name: config.load(None, one["environment"]) for name, one in services.items()}
    assert [name for name, one in insecure.items() if one.bus.insecure] == ["router"]
    listening(insecure["router"].bus)  # or it would not start


def test_with_tls_everybody_has_credentials_and_the_router_a_roster() -> None:
    secured = resolved(SECURED)["services"]
    assert secured.keys() == {*SERVICES, "roster", "backup"}
    assert secured["roster"]["profiles"] == ["roster"]
    folder = secured["roster"]["environment"]["COVINZ__BUS__ROSTER"]
    assert f"-m 700 {folder} " in DOCKERFILE
    for name in SERVICES:
        bus = config.load(None, secured[name]["environment"]).bus
        # The name is one of those in the certificate of every router.
        assert endpoints.parse(bus.endpoint) == endpoints.Endpoint("tls", "router", 7447)
        assert bus.credentials == Roster(Path(folder)).server_credentials
        assert not bus.insecure
        (mount,) = [one for one in secured[name]["volumes"] if one["target"] == folder]
        assert mount["read_only"] is True
        assert bus.roster == (Path(folder) if name == "router" else None)
    assert "router" in LOCAL_HOSTS


def test_with_tls_every_published_port_is_encrypted() -> None:
    router = resolved(SECURED, COVINZ_LISTEN="10.8.0.1")["services"]["router"]
    bus = config.load(None, router["environment"]).bus
    where = [endpoints.parse(text) for text in bus.listen]
    assert [(one.protocol, one.host, one.port) for one in where] == [
        ("tls", "0.0.0.0", 7447),
        ("quic", "0.0.0.0", 7447),
    ]
    published = {(one["host_ip"], one["protocol"], one["target"]) for one in router["ports"]}
    assert published == {("10.8.0.1", "tcp", 7447), ("10.8.0.1", "udp", 7447)}


@pytest.mark.parametrize("name", sorted(SERVICES))
def test_containers_may_do_little_and_come_back(services: Json, name: str) -> None:
    found = services[name]
    assert found["read_only"] is True
    assert found["cap_drop"] == ["ALL"]
    assert found["security_opt"] == ["no-new-privileges:true"]
    assert found["restart"] == "unless-stopped"
    assert found["stop_grace_period"] == f"{supervisor.STOP_GRACE_S:.0f}s"
    assert supervisor.STOP_GRACE_S > service.STOP_GRACE_S
    waits = {other: wait["condition"] for other, wait in found.get("depends_on", {}).items()}
    assert waits == ({} if name == "router" else {"router": "service_healthy"})


def test_the_image_is_built_once_and_never_fetched(services: Json) -> None:
    assert {found["image"] for found in services.values()} == {"covinz"}
    assert [name for name, found in services.items() if "build" in found] == ["router"]
    assert all(
        found.get("pull_policy") == "never" for name, found in services.items() if name != "router"
    )


def test_the_dockerfile_needs_no_particular_builder_and_ends_without_root() -> None:
    assert not re.search(r"--mount|--link|--chmod|<<\s*['\"]?[A-Z]|^# syntax", DOCKERFILE, re.M)
    stages = re.findall(r"^FROM (\S+)", DOCKERFILE, re.M)
    assert set(stages) == {"python:3.11-slim-bookworm"}
    assert re.findall(r"^USER (\S+)", DOCKERFILE, re.M) == ["covinz"]


def test_the_builder_is_sent_exactly_what_is_copied() -> None:
    copies = re.findall(r"^COPY (?!--from)(.*)$", DOCKERFILE, re.M)
    copied = {source for line in copies for source in line.split()[:-1]}
    allowed = re.findall(r"^!(\S+)$", (ROOT / ".dockerignore").read_text(), re.M)
    assert copied == set(allowed)
    assert all((ROOT / source).exists() for source in copied)


def test_libraries_use_one_thread_in_the_image() -> None:
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        assert re.search(rf"\b{name}=1\b", DOCKERFILE)


def test_the_check_hands_a_scenarios_settings_to_the_containers() -> None:
    settings = {
        "place_recognition": {"num_candidates": 2, "score": "tf_idf"},
        "loop_solver": {"matching": {"mutual": False}, "max_translation_m": None},
        "optimizer": {"odometry_of": {"a0": {"min_rotation": 0.1}}},
    }
    assert config.with_environment({}, environment(settings)) == settings


def test_containers_share_the_processors_as_the_processes_of_covinz_up_do(services: Json) -> None:
    for name, niceness in config.Config().niceness.model_dump().items():
        # The scheduler's weight of a process, within a step and a half of niceness: sched(7).
        weight = 1024 * 1.25**-niceness
        assert services[name].get("cpu_shares", 1024) / weight == pytest.approx(1.0, abs=0.4), name
