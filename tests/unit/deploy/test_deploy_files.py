"""Image, composition, unit and manifests: keys that matter, and every command that they run."""

import configparser
import json
import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from orbitfb.cli.app import app
from orbitfb.config.load import load_config
from orbitfb.panel.access import read_access
from orbitfb.panel.pv_table import Extent, panel_pvs, writable_names
from orbitfb.panel.settings import PanelSettings

ROOT = Path(__file__).parents[3]
DEPLOY = ROOT / "deploy"
INSTALLED = "/etc/orbitfb/orbitfb.toml"
USER = 10001
WRITABLE = writable_names(panel_pvs(PanelSettings(), Extent("x", 180, 180)))


def instructions() -> list[tuple[str, str]]:
    """Instructions of the Dockerfile with their arguments, continued lines joined."""
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    text = "\n".join(line for line in lines if not line.startswith("#"))
    whole = text.replace("\\\n", " ")
    return [(w, a) for w, _, a in (line.partition(" ") for line in whole.splitlines() if line)]


def last(word: str) -> str:
    return [arguments for its, arguments in instructions() if its == word][-1]


def loaded(name: str) -> list[dict[str, Any]]:
    return list(yaml.safe_load_all((DEPLOY / name).read_text()))


def compose(name: str = "compose.yaml") -> dict[str, Any]:
    return loaded(name)[0]["services"]


def unit() -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str
    parser.read(DEPLOY / "systemd/orbitfb.service")
    return parser


def pod() -> dict[str, Any]:
    return loaded("kubernetes/statefulset.yaml")[0]["spec"]["template"]["spec"]


def probe(name: str) -> dict[str, Any]:
    return pod()["containers"][0][name]


def commands() -> dict[str, list[str]]:
    """Every command line of orbitfb in the files."""
    entry = json.loads(last("ENTRYPOINT"))
    check = last("HEALTHCHECK").partition("CMD ")[2]
    return {
        "image": [*entry, *json.loads(last("CMD"))],
        "image, health": json.loads(check),
        "compose": [*entry, *compose()["orbitfb"]["command"]],
        "compose, live": [*entry, *compose("compose.live.yaml")["orbitfb"]["command"]],
        "systemd": shlex.split(unit()["Service"]["ExecStart"]),
        "kubernetes": [*entry, *pod()["containers"][0]["args"]],
        "kubernetes, startup": probe("startupProbe")["exec"]["command"],
    }


@pytest.mark.parametrize("where", commands())
def test_every_command_is_one_that_the_program_takes(where: str):
    program, name, *options = commands()[where]
    assert program in ("orbitfb", "/opt/orbitfb/bin/orbitfb")
    command = typer.main.get_command(app).commands[name]
    given = command.make_context(name, [*options]).params  # parses, and runs nothing
    if name == "run":
        assert str(given["config_file"]) == INSTALLED
        assert (given["ioc"], given["live"], given["start"]) in (
            ("sim", False, None),
            ("env", True, "open"),
        )


def test_every_copied_source_is_there_and_reaches_the_build():
    ignored = (ROOT / ".dockerignore").read_text().splitlines()
    assert ignored[1] == "*"
    allowed = {line[1:] for line in ignored if line.startswith("!")}
    sources = [
        source
        for word, arguments in instructions()
        if word == "COPY" and not arguments.startswith("--from=")
        for source in arguments.split()[:-1]
    ]
    assert set(sources) == allowed
    for source in sources:
        assert (ROOT / source).exists(), source


def test_stages_are_copied_from_by_names_that_exist_before():
    known: set[str] = set()
    for word, arguments in instructions():
        if word == "FROM":
            known |= set(arguments.split(" AS ")[1:])
        if word == "COPY" and arguments.startswith("--from="):
            assert arguments.removeprefix("--from=").split()[0] in known
    assert known == {"wheel", "environment"}


def test_the_image_has_the_python_of_the_project_and_pinned_packages():
    bases = {arguments.split()[0] for word, arguments in instructions() if word == "FROM"}
    assert bases == {"python:3.11-slim-bookworm"}
    assert "PYTHON ?= python3.11" in (ROOT / "Makefile").read_text()
    for word, arguments in instructions():
        for installs in re.findall(r"pip install[^&]*", arguments if word == "RUN" else ""):
            assert "--constraint" in installs
    torch = next(a for w, a in instructions() if w == "RUN" and a.rstrip().endswith("torch"))
    assert "download.pytorch.org/whl/cpu" in torch


def test_the_image_runs_as_nobody_in_particular_where_it_may_write():
    assert last("USER") == f"{USER}:{USER}"
    words = [word for word, _ in instructions()]
    assert words.index("USER") < words.index("ENTRYPOINT")
    made = next(a for w, a in instructions() if w == "RUN" and "useradd" in a)
    assert f"--uid {USER}" in made and "/var/lib/orbitfb" in made and "/run/orbitfb" in made
    assert "ORBITFB_DATA_DIRECTORY=/var/lib/orbitfb" in last("ENV")
    assert last("VOLUME") == "/var/lib/orbitfb"


def test_the_extra_that_the_image_installs_exists():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    installs = next(a for w, a in instructions() if w == "RUN" and "orbitfb-*.whl" in a)
    assert re.findall(r"whl\)\[(\w+)\]", installs)[0] in project["optional-dependencies"]


def test_the_installed_configuration_is_loopback_and_quiet():
    config = load_config(DEPLOY / "orbitfb.toml", environment={})
    assert config.observe.host == config.panel.interface == "127.0.0.1"
    assert config.panel.enabled and config.observe.terminal.mode == "off"
    assert config.observe.logs.stderr
    assert str(config.panel.rules) == "/etc/orbitfb/access.toml"


def test_services_are_bound_to_loopback_and_confined():
    services = compose()
    assert set(services) == {"orbitfb", "prometheus", "alertmanager", "grafana"}
    for service in services.values():
        assert service["network_mode"] == "host" and "ports" not in service
        assert service["cap_drop"] == ["ALL"] and not service.get("privileged")
        assert "no-new-privileges:true" in service["security_opt"]
    assert services["orbitfb"]["read_only"] is True
    assert "--web.listen-address=127.0.0.1:9090" in services["prometheus"]["command"]
    settings = services["grafana"]["environment"]
    assert settings["GF_SERVER_HTTP_ADDR"] == "127.0.0.1"
    assert settings["GF_AUTH_ANONYMOUS_ORG_ROLE"] == "Viewer"
    assert loaded("compose.yaml")[0]["secrets"]["grafana"] == {"environment": "GRAFANA_PASSWORD"}


def test_who_asks_whom_agrees():
    config, services = load_config(DEPLOY / "orbitfb.toml", environment={}), compose()
    [prometheus] = loaded("prometheus/prometheus.yml")
    [jobs] = prometheus["scrape_configs"]
    assert jobs["static_configs"] == [{"targets": [f"127.0.0.1:{config.observe.port}"]}]
    [alerts] = prometheus["alerting"]["alertmanagers"]
    [target] = alerts["static_configs"][0]["targets"]
    assert f"--web.listen-address={target}" in services["alertmanager"]["command"]
    [source] = loaded("grafana/provisioning/datasources/prometheus.yaml")[0]["datasources"]
    address = source["url"].removeprefix("http://")
    assert f"--web.listen-address={address}" in services["prometheus"]["command"]
    [provider] = loaded("grafana/provisioning/dashboards/orbitfb.yaml")[0]["providers"]
    mounted = [volume.split(":")[1] for volume in services["grafana"]["volumes"]]
    assert provider["options"]["path"] in mounted


def test_what_is_mounted_is_there():
    whole = loaded("compose.yaml")[0]
    assert (DEPLOY / whole["services"]["orbitfb"]["build"]["context"] / "Dockerfile").is_file()
    assert (DEPLOY / compose("compose.live.yaml")["orbitfb"]["env_file"][0]).is_file()
    for service in whole["services"].values():
        for volume in service["volumes"]:
            source = volume.split(":")[0]
            if source.startswith("./"):
                assert (DEPLOY / source).exists(), source
            else:
                assert source in whole["volumes"]


def test_the_unit_starts_open_and_never_as_root():
    service = unit()["Service"]
    assert (service["User"], service["Group"]) == ("orbitfb", "orbitfb")
    assert service["EnvironmentFile"] == "/etc/orbitfb/service.env"
    assert (service["ProtectSystem"], service["NoNewPrivileges"]) == ("strict", "yes")
    assert service["CapabilityBoundingSet"] == ""
    assert (service["StateDirectory"], service["RuntimeDirectory"]) == ("orbitfb", "orbitfb")
    assert service["Restart"] == "on-failure"
    assert "StartLimitBurst" in unit()["Unit"] and "Install" in unit()


def test_the_pod_is_one_and_confined():
    [resource] = loaded("kubernetes/statefulset.yaml")
    assert (resource["kind"], resource["spec"]["replicas"]) == ("StatefulSet", 1)
    spec, [container] = pod(), pod()["containers"]
    assert spec["hostNetwork"] is True and spec["dnsPolicy"] == "ClusterFirstWithHostNet"
    assert spec["securityContext"]["runAsNonRoot"] is True
    assert spec["securityContext"]["runAsUser"] == USER
    assert spec["automountServiceAccountToken"] is False
    confined = container["securityContext"]
    assert confined["readOnlyRootFilesystem"] and not confined["allowPrivilegeEscalation"]
    assert confined["capabilities"] == {"drop": ["ALL"]}
    mounts = {mount["name"] for mount in container["volumeMounts"]}
    claims = {claim["metadata"]["name"] for claim in resource["spec"]["volumeClaimTemplates"]}
    assert mounts == {volume["name"] for volume in spec["volumes"]} | claims
    here = {"host": "127.0.0.1", "port": 9180}
    assert probe("livenessProbe")["httpGet"] == {**here, "path": "/healthz"}
    assert probe("readinessProbe")["httpGet"] == {**here, "path": "/readyz"}
    assert "cpu" not in container["resources"]["limits"]


def test_the_manifests_belong_together(tmp_path: Path):
    [kustomization] = loaded("kubernetes/kustomization.yaml")
    names = {path.name for path in (DEPLOY / "kubernetes").glob("*.yaml")}
    assert {*kustomization["resources"], "kustomization.yaml"} == names
    files, network = loaded("kubernetes/configuration.yaml")
    assert pod()["containers"][0]["envFrom"] == [
        {"configMapRef": {"name": network["metadata"]["name"]}}
    ]
    assert pod()["volumes"][0]["configMap"]["name"] == files["metadata"]["name"]
    for name, text in files["data"].items():
        (tmp_path / name).write_text(text)
    config = load_config(tmp_path / "orbitfb.toml", environment={})
    copied = tomllib.loads(files["data"]["orbitfb.toml"])
    assert copied == tomllib.loads((DEPLOY / "orbitfb.toml").read_text())
    assert config.observe.port == probe("livenessProbe")["httpGet"]["port"]
    assert str(config.observe.port) in probe("startupProbe")["exec"]["command"]
    assert read_access(tmp_path / "access.toml", "127.0.0.1", WRITABLE).rules
    lines = (DEPLOY / "epics/service.env").read_text().splitlines()
    words = [word for line in lines for word in shlex.split(line, comments=True)]
    assert network["data"] == dict(word.split("=", 1) for word in words)
