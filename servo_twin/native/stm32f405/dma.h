/* dma.h - DMA1 and DMA2: transfers between a peripheral and memory, in direct mode. A transfer takes no time. */
#ifndef STM32F405_DMA_H
#define STM32F405_DMA_H

#include "stm32f405/soc.h"

#define DMA_CONTROLLERS 2u
#define DMA_STREAMS 8u

typedef struct {
    uint32_t cr, ndtr, par, m0ar, fcr;
    uint32_t start; /* NDTR when it was enabled */
} dma_stream_t;

typedef struct {
    soc_t *soc;
    dma_stream_t stream[DMA_CONTROLLERS][DMA_STREAMS];
    uint32_t flags[DMA_CONTROLLERS][2]; /* LISR, HISR */
    uint32_t requests; /* bit per soc_dma_t */
    bool busy; /* a transfer may change requests */
} dma_t;

uint32_t dma_read(void *dma, uint32_t offset); /* from DMA1 on */
void dma_write(void *dma, uint32_t offset, uint32_t value);
void dma_reset(void *dma, soc_reset_t cause);

/* Level of a request. */
void dma_request(dma_t *dma, soc_dma_t request, bool on);

#endif
