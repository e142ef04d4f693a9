#!/usr/bin/env bash
# Makes a release of the last commit: `release/release.sh FOLDER` writes sdist, wheel and site there. Before that each of
# the two plays the demo in an environment of its own, with an empty cache. PYTHONS: the Pythons to try, default python3.
# It needs `pip install build 'tactable[docs]'`, and uploads nothing.
set -euo pipefail
target=$(realpath -m "${1:?give the folder of the release}")
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
version=$(sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
[[ -z $(git status --porcelain) ]] || { echo "release.sh: there are changes that are not committed" >&2; exit 1; }
grep -q "^## \[$version\]" CHANGELOG.md || echo "note: CHANGELOG.md has no section for $version"

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
git archive HEAD --prefix source/ | tar -x -C "$work"
"$python" -m build --outdir "$work/dist" "$work/source"
for each in ${PYTHONS:-python3}; do
    for built in "$work"/dist/*; do
        rm -rf "$work/environment" "$work/cache"
        "$each" -m venv "$work/environment"
        "$work/environment/bin/pip" install --quiet --disable-pip-version-check "$built"
        echo "== $each, $(basename "$built")"
        (cd "$work" && XDG_CACHE_HOME="$work/cache" "$work/environment/bin/tactable" demo --headless)
    done
done
PYTHON=$python release/site.sh "$work/site"
mkdir -p "$target"
cp -r "$work"/dist/* "$work/site" "$target"
echo "tactable $version: $target"
