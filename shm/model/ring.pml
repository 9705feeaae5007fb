/* The protocol of docs/format/ring.md as a Promela model: one client thread, the threads of one server, one channel.
 *
 * Names are those of channel.cpp, channel_server.cpp and futex.h. Every access to shared memory is a step of its own, and
 * with CRASH either side may be killed before any step. There are no time-outs, except that they tell
 * the life from the death of the other side: a wake-up that gets lost is a deadlock here.
 *
 *   BLOCKS, SUBMITS, MAILS, THREADS   sizes
 *   CRASH                             somebody may be killed
 *   ANY_BELL_FIRST                    ringers begin at any bell (else at the first: threads are alike, so that is nearly all)
 *   MUTANT_...                        one mistake each; check_ring.sh expects spin to reject every one of them
 *
 * Checked: a question is taken whole (not torn), once (not duplicated), and as it was submitted; an answer is seen whole, and
 * only for what was asked; everything that was submitted is answered, and everybody ends (not lost, no deadlock).
 * Steps that nobody else can see are joined. Memory is sequentially consistent, as the words that matter are; what the relaxed ones may do is argued in ring.md.
 */
#ifndef BLOCKS
#define BLOCKS 2
#endif
#ifndef SUBMITS
#define SUBMITS 3
#endif
#ifndef MAILS
#define MAILS 1
#endif
#ifndef THREADS
#define THREADS 2
#endif
#define SLOTS 4 /* power of two >= BLOCKS */
#define CLIENT THREADS /* its number among the sleepers */

#define FREE 0
#define SUBMITTED 2
#define RUNNING 3
#define DONE 4
#define word(use, phase) ((use) * 8 + (phase))
#define answerTo(question) ((question) + 100)

/* ---- shared memory ---- */
byte tail, ringSlot[SLOTS], state[BLOCKS];
byte low[BLOCKS], high[BLOCKS]; /* the two halves of a block's contents */
byte mailState, mailLow, mailHigh;
bool clientClosed;
byte serverSequence[THREADS], serverSleepers[THREADS], clientSequence, clientSleepers; /* the doorbells */

/* ---- the server's own memory ---- */
byte head, running[BLOCKS], lastUse[BLOCKS], mailSeen, unannounced;
bool claim, mailClaim, ended;

/* ---- the kernel, and who lives ---- */
bool asleep[THREADS + 1];
bool clientDead, serverDead;

/* ---- for the assertions ---- */
byte answeredUse[BLOCKS];
byte mailsAnswered;

inline passBell() {
#ifdef MUTANT_RINGS_ONE_BELL_ONLY
  rung = THREADS
#else
  rung++; bell = (bell + 1) % THREADS
#endif
}

/* The threads sleep at bells of their own; the ringer goes round them from the nearest one, whichever that is. With `all`
 * it wakes everybody, whatever `sleepers` says. */
inline wakeServer(all) {
#if THREADS > 1 && defined(ANY_BELL_FIRST)
  atomic { if :: bell = 0 :: bell = 1 fi }
#endif
  do
  :: atomic { rung < THREADS && !all && serverSleepers[bell] == 0 -> passBell() }
  :: atomic { rung < THREADS && (all || serverSleepers[bell] != 0) -> serverSequence[bell]++ };
    atomic { /* FUTEX_WAKE */
      woken = 0;
      if :: asleep[bell] -> asleep[bell] = false; woken = 1 :: else fi
    }
    atomic {
      serverSleepers[bell] = serverSleepers[bell] - woken;
      if :: woken == 1 && !all -> rung = THREADS :: else -> passBell() fi
    }
  :: atomic { rung >= THREADS -> rung = 0; bell = 0; woken = 0; break }
  od
}

inline wakeClient() {
  clientSequence++;
  atomic { woken = 0; if :: asleep[CLIENT] -> asleep[CLIENT] = false; woken = 1 :: else fi }
  clientSleepers = clientSleepers - woken
}

/* FUTEX_WAIT, and taking oneself off the list unless whoever woke us has done so. */
inline sleep(me, sequence, sleepers, otherDead) {
  atomic {
    if
    :: sequence == seen -> asleep[me] = true; slept = true
    :: else -> slept = false
    fi
  }
  if
  :: slept ->
    if
    :: !asleep[me] ->
#ifdef MUTANT_WOKEN_TAKES_ITSELF_OFF
      sleepers--
#else
      skip
#endif
#ifndef MUTANT_NEVER_LOOKS_AFTER_THE_OTHER
    :: atomic { asleep[me] && otherDead -> asleep[me] = false }; sleepers--
#endif
    fi
  :: else -> sleepers--
  fi;
  slept = false
}

/* ---------------------------------------------------------------- the client ---- */

byte use[BLOCKS], flying; /* its own books */
bool inFlight[BLOCKS];

inline submit(b) {
  atomic { /* nobody can see any of this before tail moves */
    use[b]++;
    low[b] = use[b];
#ifndef MUTANT_PUBLISHES_BEFORE_FILLING
    high[b] = use[b];
#endif
    state[b] = word(use[b], SUBMITTED);
    ringSlot[tail % SLOTS] = b;
    inFlight[b] = true;
    flying++;
    submits++
  }
#ifdef MUTANT_RINGS_BEFORE_PUBLISHING
  wakeServer(false);
  tail++;
#else
  tail++; /* SYNC POINT 3 */
#ifdef MUTANT_PUBLISHES_BEFORE_FILLING
  high[b] = use[b];
#endif
  wakeServer(false);
#endif
  b = 0
}

/* Sets found to a block that is answered, or BLOCKS. */
inline look() {
  found = BLOCKS;
  i = 0;
  do
  :: atomic {
      i < BLOCKS && found == BLOCKS ->
      if
      :: inFlight[i] -> /* SYNC POINT 4: one load */
        assert(state[i] == word(use[i], SUBMITTED) || state[i] == word(use[i], RUNNING) ||
               state[i] == word(use[i], DONE));
        if :: state[i] == word(use[i], DONE) -> found = i :: else fi
      :: else
      fi;
      i++
    }
  :: atomic { else -> i = 0; break }
  od
}

inline takeAnswer(b) {
  assert(low[b] == answerTo(use[b]));
  assert(high[b] == answerTo(use[b]));
  atomic { inFlight[b] = false; flying--; found = BLOCKS; seen = 0; woken = 0 }
}

inline waitAny() {
  do
  :: look();
    if
    :: found < BLOCKS -> break
    :: else ->
      clientSleepers++; /* SYNC POINT 1 */
      seen = clientSequence;
#ifndef MUTANT_NO_SECOND_LOOK
      look();
#endif
      if
      :: found < BLOCKS -> clientSleepers--; break
      :: else -> sleep(CLIENT, clientSequence, clientSleepers, serverDead)
      fi;
      if :: serverDead -> goto gone :: else fi
    fi
  od;
  takeAnswer(found)
}

inline call() {
  mailLow = posted + 1;
#ifndef MUTANT_POSTS_BEFORE_WRITING
  mailHigh = posted + 1;
#endif
  posted++;
  mailState = posted; /* SYNC POINT 5 */
#ifdef MUTANT_POSTS_BEFORE_WRITING
  mailHigh = posted;
#endif
  wakeServer(false);
  do
  :: mailState != posted -> break
  :: else ->
    clientSleepers++;
    seen = clientSequence;
    if
    :: mailState != posted -> clientSleepers--; break
    :: else -> sleep(CLIENT, clientSequence, clientSleepers, serverDead)
    fi;
    if :: serverDead -> goto gone :: else fi
  od;
  assert(mailState == posted + 1);
  assert(mailLow == answerTo(posted));
  assert(mailHigh == answerTo(posted));
  atomic { posted++; mails++ }
}

proctype Client() {
  byte submits, mails, posted, found, i, b, seen, woken, bell, rung;
  bool slept;
  {
    do
    :: submits < SUBMITS && flying < BLOCKS ->
      /* Blocks are alike: the first free one. */
      atomic { b = 0; do :: inFlight[b] -> b++ :: else -> break od }
      submit(b)
    :: flying > 0 -> waitAny()
    :: mails < MAILS -> call()
    :: submits == SUBMITS && flying == 0 && mails == MAILS -> break
    od;
    clientClosed = true; /* SYNC POINT 6 */
    wakeServer(false);
    gone: skip
  } unless { clientDead }
}

/* ---------------------------------------------------------------- the server ---- */

inline announce() {
  if
  :: clientSleepers == 0 -> unannounced = 0
  :: else ->
    queued = tail - head;
    if
#ifdef MUTANT_LAST_ANSWER_IS_NOT_ANNOUNCED
    :: queued == 0 -> unannounced++
#endif
    :: queued != 0 && unannounced + 1 < queued -> unannounced++
    :: else -> unannounced = 0; wakeClient()
    fi
  fi
}

inline serveMail() {
  if
  :: mailState != mailSeen ->
    atomic { got = !mailClaim; mailClaim = true };
    if
    :: got ->
      s = mailState;
      if
      :: s == mailSeen + 1 ->
        mailSeen = s;
        assert(mailLow == s);
        assert(mailHigh == s);
        mailLow = answerTo(s);
#ifndef MUTANT_ANSWERS_MAIL_BEFORE_WRITING
        mailHigh = answerTo(s);
#endif
        mailSeen = s + 1;
        mailState = s + 1; /* SYNC POINT 5, back */
#ifdef MUTANT_ANSWERS_MAIL_BEFORE_WRITING
        mailHigh = answerTo(s);
#endif
        if :: clientSleepers == 0 :: else -> wakeClient() fi;
        atomic { mailsAnswered++; assert(mailsAnswered <= MAILS) };
        served = true
      :: else -> assert(s == mailSeen)
      fi;
      mailClaim = false
    :: else
    fi
  :: else
  fi
}

inline serveBlock() {
  b = BLOCKS;
  if
  :: tail != head -> /* SYNC POINT 3 */
#ifdef MUTANT_NO_CLAIM
    got = true;
#else
    atomic { got = !claim; claim = true };
#endif
    if
    :: got ->
      s = head;
      if
      :: atomic { tail != s -> /* these words are ours from here on */
        b = ringSlot[s % SLOTS];
        question = state[b];
        assert(running[b] == 0); /* "submitted twice" */
        assert(question % 8 == SUBMITTED);
        question = question / 8;
        assert(question > lastUse[b]);
        lastUse[b] = question;
        running[b] = question;
        state[b] = word(question, RUNNING)
#ifdef MUTANT_NO_CLAIM
        } head = s + 1
#else
        ; head = s + 1 }
#endif
      :: else
      fi;
      claim = false
    :: else
    fi
  :: else
  fi;
  if
  :: b < BLOCKS ->
    assert(low[b] == question);
    assert(high[b] == question);
    atomic { assert(answeredUse[b] < question); answeredUse[b] = question };
    low[b] = answerTo(question);
#ifdef MUTANT_ANSWERS_BEFORE_WRITING
    running[b] = 0;
    state[b] = word(question, DONE);
    high[b] = answerTo(question);
#else
    high[b] = answerTo(question);
#ifdef MUTANT_STATE_BEFORE_RUNNING
    state[b] = word(question, DONE);
    running[b] = 0;
#else
    running[b] = 0;
    state[b] = word(question, DONE); /* SYNC POINT 4 */
#endif
#endif
    announce();
    served = true
  :: else
  fi
}

proctype Server(byte me) {
  byte s, b, question, seen, woken, queued, bell, rung;
  bool got, served, slept;
  {
    do
    :: ended -> break
    :: else ->
      served = false;
      serveMail();
      serveBlock();
      if
      :: served
      :: else ->
        if
        :: clientClosed -> ended = true; wakeServer(true)
        :: else ->
          serverSleepers[me]++; /* SYNC POINT 1 */
          seen = serverSequence[me];
          if
#ifndef MUTANT_SERVER_HAS_NO_SECOND_LOOK
          :: ended || tail != head || mailState != mailSeen || clientClosed -> serverSleepers[me]--
#endif
          :: else ->
            sleep(me, serverSequence[me], serverSleepers[me], clientDead);
            if :: clientDead -> break :: else fi
          fi
        fi
      fi;
      atomic { s = 0; b = 0; question = 0; seen = 0; woken = 0; queued = 0; got = false }
    od
  } unless { serverDead }
}

init {
  byte t;
  atomic {
    run Client();
    for (t : 0 .. THREADS - 1) { run Server(t) }
  }
#ifdef CRASH
  if
  :: clientDead = true
  :: serverDead = true
  :: skip
  fi
#endif
}
