/* A shift of the wall clock, for one process and its children, that may change at any moment.
 *
 * JUMPING_CLOCK names a file of eight bytes, a double: seconds to add to the system's wall clock.
 * The monotonic clock, which setting a system's clock does not touch, stays as it is. Waits until
 * an absolute time of the wall clock end when the shifted clock has that time, by the shift at
 * their beginning. File times are the kernel's and are not shifted.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <math.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define WALL_CLOCK 1000000000 /* absolute times below, in seconds, are of the monotonic clock */

static const volatile double *shift;

__attribute__((constructor)) static void open_shift(void) {
    const char *path = getenv("JUMPING_CLOCK");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0) return;
    void *page = mmap(NULL, sizeof(double), PROT_READ, MAP_SHARED, file, 0);
    if (page != MAP_FAILED) shift = page;
    close(file);
}

static void add(struct timespec *when, double sign) {
    if (!shift) return;
    double seconds = sign * *shift, whole = floor(seconds);
    when->tv_sec += (time_t)whole;
    when->tv_nsec += (long)((seconds - whole) * 1e9);
    if (when->tv_nsec >= 1000000000) {
        when->tv_nsec -= 1000000000;
        when->tv_sec++;
    }
}

static int is_wall(clockid_t clock) {
    return clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE || clock == CLOCK_TAI;
}

static struct timespec system_time(const struct timespec *shifted) {
    struct timespec result = *shifted;
    if (result.tv_sec > WALL_CLOCK) add(&result, -1);
    return result;
}

static void *next(const char *name, const char *version) {
    void *found = version ? dlvsym(RTLD_NEXT, name, version) : NULL;
    return found ? found : dlsym(RTLD_NEXT, name);
}

#define NEXT(name, version) ((__typeof__(&name))next(#name, version))

int clock_gettime(clockid_t clock, struct timespec *result) {
    static __typeof__(&clock_gettime) real;
    if (!real) real = NEXT(clock_gettime, NULL);
    int status = real(clock, result);
    if (!status && is_wall(clock)) add(result, 1);
    return status;
}

int gettimeofday(struct timeval *restrict result, void *restrict zone) {
    struct timespec now;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &now);
    result->tv_sec = now.tv_sec;
    result->tv_usec = now.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *result) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (result) *result = now.tv_sec;
    return now.tv_sec;
}

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *until,
                    struct timespec *rest) {
    __typeof__(&clock_nanosleep) real = NEXT(clock_nanosleep, NULL);
    struct timespec end = *until;
    if ((flags & TIMER_ABSTIME) && is_wall(clock)) add(&end, -1);
    return real(clock, flags, &end, rest);
}

int pthread_cond_timedwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
                           const struct timespec *restrict until) {
    struct timespec end = system_time(until);
    return NEXT(pthread_cond_timedwait, "GLIBC_2.3.2")(condition, mutex, &end);
}

int pthread_cond_clockwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
                           clockid_t clock, const struct timespec *restrict until) {
    struct timespec end = system_time(until);
    return NEXT(pthread_cond_clockwait, NULL)(condition, mutex, clock, &end);
}

int pthread_mutex_timedlock(pthread_mutex_t *restrict mutex,
                            const struct timespec *restrict until) {
    struct timespec end = system_time(until);
    return NEXT(pthread_mutex_timedlock, NULL)(mutex, &end);
}

int sem_timedwait(sem_t *restrict semaphore, const struct timespec *restrict until) {
    struct timespec end = system_time(until);
    return NEXT(sem_timedwait, NULL)(semaphore, &end);
}

int sem_clockwait(sem_t *restrict semaphore, clockid_t clock,
                  const struct timespec *restrict until) {
    struct timespec end = system_time(until);
    return NEXT(sem_clockwait, NULL)(semaphore, clock, &end);
}
