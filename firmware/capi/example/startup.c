/* Start-up of an STM32F405 for the emulator: vectors, the FPU, variables, main, and the way out.
 *
 * It stays on the internal oscillator and talks through semihosting, which faults on a chip without a debugger: a real
 * board brings its own clocks and its own words. */
#include <stdint.h>

#include "board.h"

extern uint32_t __stack_top, __data_start, __data_end, __data_load, __bss_start, __bss_end;

int main(void);

/* Semihosting (ARM 100863): operation in r0, parameters in r1. */
static int host(int operation, const void *parameters)
{
	register int r0 __asm__("r0") = operation;
	register const void *r1 __asm__("r1") = parameters;
	__asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
	return r0;
}

void board_print(const char *text)
{
	enum { SYS_WRITE0 = 0x04 };
	host(SYS_WRITE0, text);
}

static __attribute__((noreturn)) void leave(uint32_t status)
{
	enum { SYS_EXIT_EXTENDED = 0x20, APPLICATION_EXIT = 0x20026 };
	const uint32_t parameters[2] = { APPLICATION_EXIT, status };
	host(SYS_EXIT_EXTENDED, parameters);
	for (;;)
		;
}

static void fault(void)
{
	leave(99);
}

void start(void)
{
	/* Full access to coprocessors 10 and 11, the FPU, before the first float (ARM DDI 0439, 7.3). */
	*(volatile uint32_t *)0xE000ED88 |= 0xFu << 20;
	__asm__ volatile("dsb\n isb" ::: "memory");
	const uint32_t *load = &__data_load;
	for (uint32_t *word = &__data_start; word < &__data_end; word++)
		*word = *load++;
	for (uint32_t *word = &__bss_start; word < &__bss_end; word++)
		*word = 0;
	leave((uint32_t)main());
}

__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
	(void (*)(void))&__stack_top, start, fault, fault, fault, fault, fault,
};
