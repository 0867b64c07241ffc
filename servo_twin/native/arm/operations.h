/* operations.h - the operations that instructions are decoded into. */
#ifndef ARM_OPERATIONS_H
#define ARM_OPERATIONS_H

/* Forms of the second operand: immediate, register, register shifted by an immediate (ROX: ROR, or RRX with 0). */
#define ARM_FORMS(X, name) X(name, IMM) X(name, REG) X(name, LSL) X(name, LSR) X(name, ASR) X(name, ROX)

/* d = n (operation) second operand; the second kind sets the flags. */
#define ARM_DATA(X)                                                                                                    \
    ARM_FORMS(X, AND)                                                                                                  \
    ARM_FORMS(X, BIC)                                                                                                  \
    ARM_FORMS(X, ORR)                                                                                                  \
    ARM_FORMS(X, ORN)                                                                                                  \
    ARM_FORMS(X, EOR)                                                                                                  \
    ARM_FORMS(X, ADD)                                                                                                  \
    ARM_FORMS(X, ADC)                                                                                                  \
    ARM_FORMS(X, SBC)                                                                                                  \
    ARM_FORMS(X, SUB)                                                                                                  \
    ARM_FORMS(X, RSB)                                                                                                  \
    ARM_FORMS(X, MOV)                                                                                                  \
    ARM_FORMS(X, MVN)

#define ARM_BOTH(name, form) OP_##name##_##form, OP_##name##S_##form,

/* Loads and stores of a register: offset, register offset, and with the base written back before or after. */
#define ARM_TRANSFERS(X) X(LDR) X(LDRB) X(LDRH) X(LDRSB) X(LDRSH) X(STR) X(STRB) X(STRH)
#define ARM_ADDRESSING(name) OP_##name##_IMM, OP_##name##_REG, OP_##name##_PRE, OP_##name##_POST,

typedef enum {
    OP_DECODE, /* not decoded yet; 0 */
    ARM_DATA(ARM_BOTH) ARM_TRANSFERS(ARM_ADDRESSING)
    /* shifts by a register: type x */
    OP_SHIFT,
    OP_SHIFTS,
    OP_MOVT,
    OP_MUL,
    OP_MULS,
    OP_MLA,
    OP_MLS,
    OP_SMULL,
    OP_UMULL,
    OP_SMLAL,
    OP_UMLAL,
    OP_SDIV,
    OP_UDIV,
    OP_SMULXY,
    OP_SMLAXY,
    OP_SSAT,
    OP_USAT,
    OP_SBFX,
    OP_UBFX,
    OP_BFI,
    OP_SXTB, /* of m rotated right by x, and n added by the four with A */
    OP_SXTH,
    OP_UXTB,
    OP_UXTH,
    OP_SXTAB,
    OP_SXTAH,
    OP_UXTAB,
    OP_UXTAH,
    OP_CLZ,
    OP_DSP, /* imm: dsp_t */
    OP_LDRD,
    OP_STRD,
    OP_LDM,
    OP_STM,
    OP_BRANCH_TO, /* imm: the address, with bit 0 */
    OP_LDR_PC, /* x: OP_LDR_IMM.. minus OP_LDR_IMM */
    OP_TBB,
    OP_TBH,
    OP_B,
    OP_BEQ, /* and the other thirteen conditions in their order */
    OP_BNE,
    OP_BCS,
    OP_BCC,
    OP_BMI,
    OP_BPL,
    OP_BVS,
    OP_BVC,
    OP_BHI,
    OP_BLS,
    OP_BGE,
    OP_BLT,
    OP_BGT,
    OP_BLE,
    OP_BL,
    OP_BX, /* also MOV PC */
    OP_BLX,
    OP_CBZ,
    OP_CBNZ,
    OP_CONDITIONAL, /* x: condition; the instruction is in the second half of the table */
    OP_NOP,
    OP_WFI,
    OP_CPS,
    OP_MRS,
    OP_MSR,
    OP_BKPT,
    OP_UNDEFINED
} operation_t;

/* Rare operations of the DSP extension, and reversals (dsp.c). */
typedef enum {
    DSP_REV,
    DSP_REV16,
    DSP_REVSH,
    DSP_RBIT,
    DSP_SEL,
    DSP_QADD,
    DSP_QDADD,
    DSP_QSUB,
    DSP_QDSUB,
    DSP_PARALLEL, /* x: operation, y: prefix */
    DSP_SXTAB16,
    DSP_UXTAB16,
    DSP_PKHBT,
    DSP_PKHTB,
    DSP_SSAT16,
    DSP_USAT16,
    DSP_SMLAD, /* x: exchanged halves, y: the second product is subtracted, z: the accumulator is added */
    DSP_SMLAW,
    DSP_SMMLA, /* x: rounded, y: the product is subtracted */
    DSP_USADA8,
    DSP_SMLALXY,
    DSP_SMLALD,
    DSP_UMAAL
} dsp_t;

enum { SHIFT_LSL, SHIFT_LSR, SHIFT_ASR, SHIFT_ROR };

#endif
