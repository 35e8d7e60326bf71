#!/bin/sh
# Debian packages of the project, by what needs them.
#
#   packages.sh install SET...   installs those that are missing, as root or by sudo; where that is not possible or no package
#                                manager is known, names them, exit code 1. With a package that the build needs come those of
#                                `convenience`; these alone are installed when they are asked for
#   packages.sh missing SET...   names those that are missing

# set, package, what it is for
table='
build g++ the compiler
build cmake the build
build pkg-config finds libraries for CMake
build libembree-dev rays and meshes
build libopenexr-dev images
build libopenimageio-dev textures
build libhdf5-dev path graphs and cubes on disk
build libflann-dev neighbours of a vertex
build libpugixml-dev scene files
build libcli11-dev command lines
build libtbb-dev threads
build libfmt-dev text
build libspdlog-dev logs
build libxxhash-dev hashes of files
build nlohmann-json3-dev JSON
build libboost-dev p-values
build zlib1g-dev compressed meshes
build libpng-dev previews
build libgtest-dev tests
convenience ninja-build faster builds
convenience ccache faster builds again
convenience gnuplot-nox charts and images of cubes
lint clang-tidy-16 make lint
peers python3-venv an environment for programs from PyPI
mitsuba libllvm16 the llvm variants of Mitsuba
browser chromium the test of the report in a browser
'

wanted() { # SET...: packages
    for set in "$@"; do printf '%s' "$table" | sed -n "s/^$set \([^ ]*\) .*/\1/p"; done
}
lacking() { # PACKAGE...: those that are not installed
    have=" $(dpkg-query -W -f='${db:Status-Status} ${Package}\n' "$@" 2>/dev/null | sed -n 's/^installed //p' | tr '\n' ' ') "
    for package in "$@"; do
        case $have in *" $package "*) ;; *) printf '%s ' "$package" ;; esac
    done
}
name() { # PACKAGE...: what they are for, and what to do
    if command -v dpkg-query >/dev/null; then echo 'Missing packages of Debian:'; else echo 'No dpkg here; needed are these packages of Debian or their equivalents:'; fi
    for package in "$@"; do printf '%s' "$table" | sed -n "s/^[a-z]* \($package\) \(.*\)/  \1\t\2/p"; done | awk -F'\t' '{ printf "%-20s %s\n", $1, $2 }'
    echo 'As root:'
    echo "  apt-get install $*"
    echo 'Libraries that lie elsewhere are found by CMake, after which make goes on:'
    echo "  cmake -S . -B ${BUILD:-build} -DCMAKE_BUILD_TYPE=Release -DCMAKE_PREFIX_PATH=FOLDER"
}

command=$1
shift
missing=$(lacking $(wanted "$@"))
[ -n "$missing" ] || exit 0
if [ "$command" = install ] && command -v apt-get >/dev/null; then
    case " $* " in *' build '*) missing=$(lacking $(wanted "$@" convenience)) ;; esac
    root=
    if [ "$(id -u)" != 0 ]; then
        # A password is asked for only at a terminal.
        if sudo -n true 2>/dev/null || { [ -t 0 ] && command -v sudo >/dev/null && sudo -v; }; then root=sudo; else root=none; fi
    fi
    if [ "$root" != none ]; then
        echo "installing: $missing"
        $root apt-get update -qq && $root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $missing && exit 0
    fi
fi
name $missing
[ "$command" = missing ]
