#!/bin/sh
# Whether the sources have the shape that .clang-format says; exit code 77 (skipped) without clang-format 14, whose rules
# these are: other releases shape some lines otherwise. With --fix they are given that shape.
cd "$(dirname "$0")/.." || exit 1
case $(clang-format --version 2>/dev/null) in
    *' version 14.'*) ;;
    *) echo 'no clang-format 14: apt-get install clang-format-14' >&2; exit 77 ;;
esac
action='--dry-run -Werror'
[ "$1" = --fix ] && action=-i
find formats stages tests -name '*.cpp' -o -name '*.h' -o -name '*.inl' | LC_ALL=C sort | xargs clang-format $action
