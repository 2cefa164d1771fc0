#!/usr/bin/env bash
# All tests, with what they need installed. Tests run optimized, with every assertion kept.
set -euo pipefail
cd "$(dirname "$0")"

./setup.sh tests
cargo test --workspace --profile ci
