"""What each member of a roster may do on the bus: Zenoh's access control, as data.

Everything that is not allowed here is denied, in both directions. Source: decision 0024.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from covinz import keyexprs
from covinz.access.credentials import Role

# Zenoh 1.10's kinds of messages.
ALL_MESSAGES = (
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)
Rule = dict[str, object]


def common_name(role: Role, name: str) -> str:
    """The subject of a member's certificate; a dot is in no name, so no two are the same."""
    return f"{role}.{name}"


def access_control(members: Iterable[tuple[str, Role]]) -> dict[str, object]:
    """Zenoh's section `access_control` for these (name, role)."""
    rules: list[Rule] = []
    subjects: list[dict[str, object]] = []
    policies: list[dict[str, object]] = []
    for name, role in sorted(members):
        subject = common_name(role, name)
        own = _agent_rules(name) if role == "agent" else _server_rules(name)
        rules += own
        subjects.append({"id": subject, "cert_common_names": [subject]})
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [subject]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _agent_rules(agent: str) -> list[Rule]:
    """A robot: its uploads, its corrections, its token. It answers nobody."""
    up, down = keyexprs.agent_up(agent), keyexprs.agent_down(agent)

    def rule(what: str, flow: str, messages: Sequence[str], keys: Sequence[str]) -> Rule:
        return _allow(f"{common_name('agent', agent)} {what}", flow, messages, keys)

    return [
        rule("asks", "ingress", ["query"], [up, down]),
        rule("is answered", "egress", ["reply"], [up, down]),
        rule("publishes", "ingress", ["put"], [up]),
        rule("listens", "ingress", ["declare_subscriber"], [down]),
        rule("is told", "egress", ["put"], [down]),
        rule("is alive", "ingress", ["liveliness_token"], [keyexprs.agent_alive(agent)]),
        # Who answers says so for all robots at once: an allowed key must include what is declared.
        rule("sees answerers", "egress", ["declare_queryable"], keyexprs.AGENTS_ANSWERED),
    ]


def _server_rules(name: str) -> list[Rule]:
    """A process of the server, or an operator: everything."""
    subject = common_name("server", name)
    return [_allow(f"{subject} {flow}", flow, ALL_MESSAGES, ["**"]) for flow in _FLOWS]


_FLOWS = ("ingress", "egress")


def _allow(name: str, flow: str, messages: Sequence[str], keys: Sequence[str]) -> Rule:
    return {
        "id": name,
        "permission": "allow",
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(keys),
    }
