/* Slow motion for user-mode Linux (in_uml.sh -s): loaded before the C library, it hands the kernel another time.
 *
 * The emulated machine's clocks go on by a SLOW_MOTION-th of the processor time that it is given, and what it would sleep
 * through is skipped. To the programs inside it is a machine with a processor so much faster, on which a wait takes no
 * time: they keep their deadlines whatever else this machine does, and do not see that they were stopped meanwhile.
 *
 * User-mode Linux is a process for the kernel and one for each address space of its programs, of which one runs at a time
 * and is led by ptrace. It takes its time from few calls of the C library: clock_gettime, one timer, and sigsuspend when
 * there is nothing to do (arch/um/os-Linux of Linux 6.1). It has no inputs that it might wait for there. A timer that
 * fires early does no harm: the kernel looks at the clock and sets it again.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdarg.h>
#include <stdlib.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <time.h>

typedef long long nanoseconds;
static const nanoseconds SECOND = 1000000000;
static const int OLD_SETOPTIONS = 21;

static nanoseconds slowness, begin[2]; /* begin: of CLOCK_REALTIME and CLOCK_MONOTONIC, which are 0 and 1 */
static nanoseconds skipped, elapsed;   /* elapsed: never less than what was told, for a signal may come in between */
static nanoseconds finished, seen; /* processor time: of programs led before the present one, and of that */
static volatile sig_atomic_t changing; /* these are: what a signal interrupts is asked for the time, too */
static pid_t program;
static clockid_t program_clock;
static timer_t alarm_timer;

static int (*clock_read)(clockid_t, struct timespec *);
static int (*timer_make)(clockid_t, struct sigevent *, timer_t *);
static int (*timer_arm)(timer_t, int, const struct itimerspec *, struct itimerspec *);
static int (*timer_left)(timer_t, struct itimerspec *);
static int (*wait_for_signal)(const sigset_t *);
static long (*lead)(int, pid_t, void *, void *);

static nanoseconds count(struct timespec t) { return t.tv_sec * SECOND + t.tv_nsec; }
static struct timespec spec(nanoseconds n) { return (struct timespec){n / SECOND, n % SECOND}; }

__attribute__((constructor)) static void prepare(void)
{
	struct timespec now;
	const char *wanted = getenv("SLOW_MOTION");

	slowness = wanted && atoll(wanted) > 0 ? atoll(wanted) : 1;
	clock_read = dlsym(RTLD_NEXT, "clock_gettime");
	timer_make = dlsym(RTLD_NEXT, "timer_create");
	timer_arm = dlsym(RTLD_NEXT, "timer_settime");
	timer_left = dlsym(RTLD_NEXT, "timer_gettime");
	lead = dlsym(RTLD_NEXT, "ptrace");
	wait_for_signal = dlsym(RTLD_NEXT, "sigsuspend");
	for (int clock = 0; clock < 2; clock++) {
		clock_read(clock, &now);
		begin[clock] = count(now);
	}
}

/* Processor time of the program that is led; what it was last where it is gone. */
static nanoseconds used_by_program(void)
{
	struct timespec used;

	if (program && clock_read(program_clock, &used) == 0)
		seen = count(used);
	return seen;
}

long ptrace(enum __ptrace_request request, ...)
{
	va_list rest;
	pid_t pid;
	void *address, *data;

	va_start(rest, request);
	pid = va_arg(rest, pid_t);
	address = va_arg(rest, void *);
	data = va_arg(rest, void *);
	va_end(rest);
	if (pid != program) {
		changing = 1;
		finished += used_by_program();
		program = clock_getcpuclockid(pid, &program_clock) == 0 ? pid : 0;
		seen = 0;
		finished -= used_by_program();
		changing = 0;
	}
	if (request == PTRACE_SETOPTIONS || (int)request == OLD_SETOPTIONS) /* no program outlives its kernel */
		data = (void *)((long)data | PTRACE_O_EXITKILL);
	return lead(request, pid, address, data);
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
	struct timespec used;
	nanoseconds present, before;

	if (clock != CLOCK_REALTIME && clock != CLOCK_MONOTONIC)
		return clock_read(clock, now);
	if (!changing) {
		clock_read(CLOCK_PROCESS_CPUTIME_ID, &used);
		present = (count(used) + finished + used_by_program()) / slowness + skipped;
		before = __atomic_load_n(&elapsed, __ATOMIC_RELAXED);
		while (present > before && !__atomic_compare_exchange_n(&elapsed, &before, present, 0, __ATOMIC_RELAXED, __ATOMIC_RELAXED))
			;
	}
	*now = spec(begin[clock] + __atomic_load_n(&elapsed, __ATOMIC_RELAXED));
	return 0;
}

int timer_create(clockid_t clock, struct sigevent *event, timer_t *timer)
{
	int status = timer_make(clock, event, timer);

	alarm_timer = *timer;
	return status;
}

int timer_settime(timer_t timer, int flags, const struct itimerspec *wanted, struct itimerspec *before)
{
	struct itimerspec slow = {spec(count(wanted->it_interval) * slowness), spec(count(wanted->it_value) * slowness)};

	return timer_arm(timer, flags, &slow, before);
}

int timer_gettime(timer_t timer, struct itimerspec *left)
{
	int status = timer_left(timer, left);

	if (status == 0) { /* rounded up: nothing left means that the timer is not armed */
		left->it_value = spec((count(left->it_value) + slowness - 1) / slowness);
		left->it_interval = spec(count(left->it_interval) / slowness);
	}
	return status;
}

int sigsuspend(const sigset_t *mask)
{
	struct itimerspec left;

	if (timer_left(alarm_timer, &left) == 0 && count(left.it_value) > 0) {
		skipped += count(left.it_value) / slowness;
		left.it_value = spec(1);
		timer_arm(alarm_timer, 0, &left, NULL);
	}
	return wait_for_signal(mask);
}
