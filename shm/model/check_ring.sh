#!/bin/sh
# Checks the model of the ring protocol with spin: it must hold, and every mutant must be rejected.
# Needs spin and a C compiler. Half a minute; FR_STRESS=1 checks larger sizes (minutes, many GB).
set -eu
model=$(cd "$(dirname "$0")" && pwd)/ring.pml
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
failed=0

# check NAME EXPECTED-ERRORS OPTIMISATION DEFINES...
check() {
  name=$1 expected=$2 optimisation=$3
  shift 3
  rm -f pan pan.*
  spin -a "$@" "$model" >spin.log 2>&1 || { cat spin.log; echo "$name: spin refuses the model"; exit 1; }
  ${CC:-cc} "$optimisation" -w -DSAFETY -DVECTORSZ=2048 -DCOLLAPSE -o pan pan.c
  ./pan -m4000000 -w24 >pan.log 2>&1 || true
  errors=$(sed -n 's/.*errors: \([0-9]*\).*/\1/p' pan.log)
  states=$(sed -n 's/^ *\([0-9.e+]*\) states, stored.*/\1/p' pan.log)
  if grep -q 'search depth too small\|out of memory\|max search depth too small' pan.log; then errors=incomplete; fi
  if [ "$errors" = "$expected" ]; then
    echo "ok    $name ($states states)"
  else
    echo "FAIL  $name: $errors errors, expected $expected"
    sed -n 1,12p pan.log
    failed=1
  fi
}

check 'one thread, two blocks' 0 -O2 -DBLOCKS=2 -DSUBMITS=3 -DMAILS=0 -DTHREADS=1
check 'one thread, three blocks' 0 -O2 -DBLOCKS=3 -DSUBMITS=4 -DMAILS=0 -DTHREADS=1
check 'two threads, two blocks' 0 -O2 -DBLOCKS=2 -DSUBMITS=2 -DMAILS=0 -DTHREADS=2
check 'two threads, any bell first' 0 -O2 -DBLOCKS=1 -DSUBMITS=1 -DMAILS=0 -DTHREADS=2 -DANY_BELL_FIRST
check 'one thread, block and mails' 0 -O2 -DBLOCKS=1 -DSUBMITS=1 -DMAILS=2 -DTHREADS=1
check 'somebody is killed, block and mail' 0 -O2 -DBLOCKS=1 -DSUBMITS=2 -DMAILS=1 -DTHREADS=1 -DCRASH
check 'somebody is killed, two blocks' 0 -O2 -DBLOCKS=2 -DSUBMITS=2 -DMAILS=0 -DTHREADS=1 -DCRASH
if [ "${FR_STRESS:-0}" != 0 ]; then
  check 'two threads, mails' 0 -O2 -DBLOCKS=1 -DSUBMITS=1 -DMAILS=2 -DTHREADS=2
  check 'two threads, two blocks, any bell first' 0 -O2 -DBLOCKS=2 -DSUBMITS=2 -DMAILS=0 -DTHREADS=2 -DANY_BELL_FIRST
  check 'two threads, everything' 0 -O2 -DBLOCKS=2 -DSUBMITS=3 -DMAILS=1 -DTHREADS=2
  check 'somebody is killed, two threads' 0 -O2 -DBLOCKS=2 -DSUBMITS=2 -DMAILS=1 -DTHREADS=2 -DCRASH
fi

mutant() {
  mutation=$1
  shift
  check "mutant $mutation is rejected" 1 -O0 "-DMUTANT_$mutation" "$@"
}
mutant RINGS_BEFORE_PUBLISHING -DMAILS=0 -DTHREADS=1
mutant NO_SECOND_LOOK -DMAILS=0 -DTHREADS=1
mutant SERVER_HAS_NO_SECOND_LOOK -DMAILS=0 -DTHREADS=1
mutant WOKEN_TAKES_ITSELF_OFF -DMAILS=0 -DTHREADS=1
mutant LAST_ANSWER_IS_NOT_ANNOUNCED -DMAILS=0 -DTHREADS=1
mutant RINGS_ONE_BELL_ONLY -DSUBMITS=2 -DMAILS=0 -DTHREADS=2
mutant PUBLISHES_BEFORE_FILLING -DMAILS=0 -DTHREADS=1
mutant ANSWERS_BEFORE_WRITING -DMAILS=0 -DTHREADS=1
mutant STATE_BEFORE_RUNNING -DMAILS=0 -DTHREADS=2
mutant NO_CLAIM -DMAILS=0 -DTHREADS=2
mutant POSTS_BEFORE_WRITING -DSUBMITS=0 -DTHREADS=1
mutant ANSWERS_MAIL_BEFORE_WRITING -DSUBMITS=0 -DTHREADS=1
mutant NEVER_LOOKS_AFTER_THE_OTHER -DSUBMITS=1 -DMAILS=0 -DTHREADS=1 -DCRASH
exit $failed
