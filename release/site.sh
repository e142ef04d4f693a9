#!/usr/bin/env bash
# Makes the documentation site of the last commit: `release/site.sh FOLDER`. A broken link fails.
# It needs `pip install 'tactable[docs]'`.
set -euo pipefail
target=$(realpath -m "${1:?give the folder of the site}")
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/pages"
git archive HEAD | tar -x -C "$work/pages"
cp release/mkdocs.yml "$work"
# Words behind the language of a block, such as `sh slow`, are for the documents' own tests.
find "$work/pages" -name "*.md" -exec sed -i -E 's/^```([a-z]+) .+/```\1/' {} +
cd "$work"
python=${PYTHON:-python3}
PYTHONPATH=pages "$python" - > pages/docs/python.md <<'P'
import tactable

print("# Python\n\nWhat `import tactable` offers, from its docstrings.\n")
for name, home in sorted(tactable._HOMES.items()):
    print(f"::: {home}.{name}\n")
P
"$python" -m mkdocs build --strict --site-dir "$target"
echo "the site: $target/index.html"
