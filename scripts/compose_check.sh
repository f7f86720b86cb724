#!/usr/bin/env bash
# Brings the server up as docker-compose.yml says, on a real engine, and plays robots against it from outside: are they in
# one map, does it stay whole while workers come, go and are killed, is it the same after everything was stopped?
# Exit code 0: passed, 1: failed, 77: skipped because there is no engine (the reason is said).
#
#   scripts/compose_check.sh [SCENARIO] [--tls] [--rate X] [--keep FOLDER]
set -euo pipefail
cd "$(dirname "$0")/.."

skip() {
  echo "SKIPPED: $1" >&2
  exit 77
}

command -v docker >/dev/null || skip "there is no docker command"
reason=$(docker info --format '{{.ServerVersion}}' 2>&1) || skip "no engine answers: ${reason##*$'\n'}"
echo "engine $reason; make setup, which is silent, takes minutes in a fresh clone"
make --silent setup

# Compose as the user has it, or the one that `make setup` installs.
if docker compose version >/dev/null 2>&1; then
  compose="docker compose"
else
  compose=".venv/bin/docker-compose"
fi
COMPOSE="$compose" exec .venv/bin/python -m scripts.compose_check "$@"
