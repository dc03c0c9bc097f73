/* Slow motion for user-mode Linux (in_uml.sh -s): loaded before the C library, it hands the kernel another time.
 *
 * While the emulated machine works, its clocks run SLOW_MOTION times slower than this machine's; what it would sleep
 * through is skipped. To the programs inside it is a machine with a processor so much faster, on which a wait takes no
 * time: they keep their deadlines whatever else this machine does.
 *
 * User-mode Linux takes its time from few calls of the C library: clock_gettime, one timer, and sigsuspend when there
 * is nothing to do (arch/um/os-Linux/time.c of Linux 6.1). It has no inputs that it might wait for in sigsuspend.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdlib.h>
#include <time.h>

typedef long long nanoseconds;
static const nanoseconds SECOND = 1000000000;

static nanoseconds slowness, begin[2], skipped; /* begin: of CLOCK_REALTIME and CLOCK_MONOTONIC, which are 0 and 1 */
static timer_t alarm_timer;

static int (*clock_read)(clockid_t, struct timespec *);
static int (*timer_make)(clockid_t, struct sigevent *, timer_t *);
static int (*timer_arm)(timer_t, int, const struct itimerspec *, struct itimerspec *);
static int (*timer_left)(timer_t, struct itimerspec *);
static int (*wait_for_signal)(const sigset_t *);

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
	wait_for_signal = dlsym(RTLD_NEXT, "sigsuspend");
	for (int clock = 0; clock < 2; clock++) {
		clock_read(clock, &now);
		begin[clock] = count(now);
	}
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
	int status = clock_read(clock, now);

	if (status == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_MONOTONIC))
		*now = spec(begin[clock] + (count(*now) - begin[clock]) / slowness + skipped);
	return status;
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
