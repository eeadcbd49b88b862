/* foretorque in a C program: 300 ticks of a moving arm while it learns, torques out through semihosting.
 *
 * Everything a board needs besides the library is in this directory: start-up, linker script, and this file. Where it reads
 * "your board", a real program talks to sensors and drives instead. */
#include "foretorque.h"

#include "board.h"

#define TICKS 300

/* The caller owns the memory. foretorque_size() is how much is needed; it is checked below. */
static _Alignas(8) unsigned char memory[80 * 1024];

/* Numbers that another machine can make exactly: a linear congruence, and sums and products of f32 with no fused steps. */
static uint32_t state = 1;

static float any(void)
{
	state = state * 1664525u + 1013904223u;
	return (float)(int32_t)state * (1.0f / 2147483648.0f);
}

static void next_sample(ForetorqueSample *sample, uint32_t tick)
{
	for (int joint = 0; joint < FORETORQUE_JOINTS; joint++) {
		/* Your board: what the arm shall do in the next tick, and what its sensors measure. */
		float way = (float)tick * 0.002f + 0.1f * (float)joint;
		sample->q_rad[joint] = way;
		sample->qd_rad_s[joint] = 2.0f + 0.1f * any();
		sample->qdd_rad_s2[joint] = any();
		sample->measured_q_rad[joint] = way;
		sample->measured_tau_nm[joint] = 10.0f * any();
	}
	sample->measured = 1;
}

static void print_bits(const float *values, int count)
{
	static const char digits[] = "0123456789abcdef";
	char line[FORETORQUE_JOINTS * 9 + 1];
	int at = 0;
	for (int k = 0; k < count; k++) {
		union { float value; uint32_t bits; } both = { .value = values[k] };
		for (int shift = 28; shift >= 0; shift -= 4)
			line[at++] = digits[(both.bits >> shift) & 15];
		line[at++] = k + 1 < count ? ' ' : '\n';
	}
	line[at] = 0;
	board_print(line);
}

int main(void)
{
	Foretorque *arm;
	ForetorqueSample sample;
	ForetorqueTorque torque;

	if (foretorque_joints() != FORETORQUE_JOINTS)
		return 7;
	if (sizeof memory < foretorque_size() || 8 % foretorque_alignment() != 0)
		return 1;
	if (foretorque_init(memory, sizeof memory, 0.001f, &arm) != FORETORQUE_STATUS_OK)
		return 2;
	foretorque_set_learning(arm, 1);

	for (uint32_t tick = 0; tick < TICKS; tick++) {
		next_sample(&sample, tick);
		/* Every tenth sample is lost on its way. */
		bool lost = tick % 10 == 9;
		if (foretorque_step(arm, lost ? NULL : &sample, &torque) != FORETORQUE_STATUS_OK)
			return 3;
		/* Your board: send torque.total_nm to the drives, then learn in what is left of the tick. */
		print_bits(torque.total_nm, FORETORQUE_JOINTS);
		foretorque_learn(arm);
	}

	/* Your board: tell the operator how far the torque can be trusted, and what is in the hand. */
	ForetorqueQuality quality;
	if (foretorque_quality(arm, &quality) != FORETORQUE_STATUS_OK || !(quality.trust <= 1.0f))
		return 8;

	/* What was learnt is a parameter bank, to be kept and given to foretorque_load_bank at the next start. */
	static uint8_t bank[FORETORQUE_BANK_BYTES];
	size_t length = 0;
	foretorque_set_learning(arm, 0);
	if (foretorque_save_bank(arm, bank, sizeof bank, &length) != FORETORQUE_STATUS_OK)
		return 4;
	if (foretorque_load_bank(arm, bank, length) != FORETORQUE_STATUS_OK)
		return 5;
	if (foretorque_step(arm, &sample, &torque) != FORETORQUE_STATUS_OK)
		return 6;
	print_bits(torque.rigid_nm, FORETORQUE_JOINTS);
	return 0;
}
