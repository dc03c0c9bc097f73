/* Copies memory while a signal's handler, which copies too, interrupts it: prints how many copies arrived wrong. */
#define _GNU_SOURCE
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>

enum { MOST = 1 << 18, SECONDS = 6 };

static char from[512], to[512];
static volatile size_t length = 300;

static void handler(int number)
{
	(void)number;
	memcpy(to, from, length);
}

int main(void)
{
	struct sigaction action = {.sa_handler = handler, .sa_flags = SA_RESTART};
	struct itimerval every = {{0, 2000}, {0, 2000}};
	unsigned char *source = malloc(MOST);
	time_t end = time(NULL) + SECONDS;
	long wrong = 0;

	for (size_t i = 0; i < MOST; i++)
		source[i] = rand() >> 7;
	sigaction(SIGALRM, &action, NULL);
	setitimer(ITIMER_REAL, &every, NULL);
	while (time(NULL) < end) {
		size_t size = 1 + rand() % (rand() & 1 ? MOST : 9000);
		unsigned char *copy = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);

		memcpy(copy, source, size);
		wrong += memcmp(copy, source, size) != 0; /* also wrong where it was interrupted, and no less rare */
		munmap(copy, size);
	}
	printf("%ld\n", wrong);
	return 0;
}
