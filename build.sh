#!/bin/sh
# Sets up frankenrender on Debian 12 and runs it. As root, or as a user who has sudo.
#
#   ./build.sh example   install what is needed, build Release, render examples/teapots/teapots.rib
#   ./build.sh test      the same set-up, then every test
#   ./build.sh packages  install the Debian packages only
#
# BUILD_DIR (default build/release) and JOBS (default: all cores) may be set.
set -eu
cd "$(dirname "$0")"
BUILD_DIR=${BUILD_DIR:-build/release}
JOBS=${JOBS:-$(nproc)}

PACKAGES="g++ cmake ninja-build pkg-config libembree-dev libopenimageio-dev openimageio-tools libopenexr-dev libtiff-dev libpng-dev libosd-dev libtbb-dev
libglm-dev libboost-dev libboost-wave-dev libboost-thread-dev libboost-filesystem-dev libboost-atomic-dev zlib1g-dev libzstd-dev libfmt-dev libspdlog-dev libcli11-dev
nlohmann-json3-dev libfast-float-dev libxxhash-dev libsleef-dev libgtest-dev libgmock-dev libbenchmark-dev
librapidcheck-dev spin python3 binutils"

install_packages() {
  missing=
  for p in $PACKAGES; do
    dpkg-query -W -f='${Status}' "$p" 2>/dev/null | grep -q 'install ok installed' || missing="$missing $p"
  done
  [ -z "$missing" ] && return 0
  root=
  if [ "$(id -u)" != 0 ]; then
    command -v sudo >/dev/null || { echo "build.sh: run as root, or install sudo: missing packages:$missing" >&2; exit 1; }
    root=sudo
  fi
  $root apt-get update -q
  # shellcheck disable=SC2086
  $root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends $missing
}

build() {
  install_packages
  cmake --preset release -B "$BUILD_DIR" >"${TMPDIR:-/tmp}/frankenrender-configure.log" 2>&1 || {
    cat "${TMPDIR:-/tmp}/frankenrender-configure.log" >&2
    exit 1
  }
  cmake --build "$BUILD_DIR" -j "$JOBS" "$@"
}

case "${1:-}" in
  packages) install_packages ;;
  example)
    build --target frankenrender rendrib scenecache slc slctell mkmip fr_display_exr fr_display_tiff fr_display_png fr_display_oiio fr_textures
    "$BUILD_DIR/bin/frankenrender" --shm --stats examples/teapots/teapots.rib
    echo "Look at teapots.png (and teapots.exr, the same picture in floating point)."
    ;;
  test)
    build
    ctest --test-dir "$BUILD_DIR" --output-on-failure -j "$JOBS"
    ;;
  *)
    sed -n '2,9s/^# \{0,1\}//p' "$0"
    [ $# -eq 0 ] || exit 2
    ;;
esac
