/* Wide registers for user-mode Linux (in_uml.sh): loaded before the C library, it lets the kernel run on processors with AMX.
 *
 * User-mode Linux keeps the floating-point registers of its programs as 2696 bytes (HOST_FP_SIZE in arch/x86/um of Linux
 * 6.1), which holds AVX-512. The kernel below writes them only as a whole, and AMX makes that 11 kB: the first program
 * would end before it began. Here its requests are made in full. What lies beyond its 2696 bytes is AMX's tiles, which are
 * switched off for programs that have not asked for them: zeros.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

enum { USED = 512 }; /* where the areas in use stand, a bit each (XSTATE_BV) */
static const uint64_t TILES = 3ull << 17;

static char whole[1 << 16]; /* not on the stack, which is 16 kB there; calls do not overlap */
static long (*lead)(int, pid_t, void *, void *);

__attribute__((constructor)) static void prepare(void) { lead = dlsym(RTLD_NEXT, "ptrace"); }

static void without_tiles(char *registers)
{
	uint64_t used;

	memcpy(&used, registers + USED, sizeof used);
	used &= ~TILES;
	memcpy(registers + USED, &used, sizeof used);
}

long ptrace(enum __ptrace_request request, ...)
{
	va_list arguments;
	struct iovec wide = {whole, sizeof whole}, *given;
	size_t size;
	long result;

	va_start(arguments, request);
	pid_t program = va_arg(arguments, pid_t);
	void *where = va_arg(arguments, void *), *data = va_arg(arguments, void *);
	va_end(arguments);

	given = data;
	if ((request != PTRACE_GETREGSET && request != PTRACE_SETREGSET) || (uintptr_t)where != NT_X86_XSTATE ||
	    given->iov_len < USED + sizeof(uint64_t))
		return lead(request, program, where, data);
	result = lead(PTRACE_GETREGSET, program, where, &wide); /* says how many bytes there are */
	size = wide.iov_len;
	if (result != 0 || size <= given->iov_len)
		return lead(request, program, where, data);
	if (request == PTRACE_GETREGSET) {
		memcpy(given->iov_base, whole, given->iov_len);
		without_tiles(given->iov_base);
		return 0;
	}
	memset(whole, 0, size);
	memcpy(whole, given->iov_base, given->iov_len);
	without_tiles(whole);
	return lead(PTRACE_SETREGSET, program, where, &wide);
}
