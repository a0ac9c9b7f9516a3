/* HD's scheduler: a thread that calls the program's callbacks at absolute deadlines, the highest priority first. */
#include "internal.h"

#include <errno.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#define CALLBACKS_MAX 64
#define NICENESS -10          /* before ordinary threads, and behind every loop */
#define RATE_LEAST 500
#define RATE_MOST 1000
#define LATE_TICKS 20         /* more are not made up for */
#define PATIENCE_NS 1000000000LL /* for a callback that runs to return */

struct entry {
    HDSchedulerHandle handle; /* 0: free */
    HDSchedulerCallback callback;
    void *data;
    HDushort priority;
};

static struct entry entries[CALLBACKS_MAX]; /* by falling priority, all in use before all free */
static int count;
static HDSchedulerHandle last_handle;
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER; /* of everything here; not held while a callback runs */
static pthread_cond_t changed;
static pthread_once_t once = PTHREAD_ONCE_INIT;
static pthread_t thread;
static bool started, ending;
static long generation; /* of the thread: one that did not come back is left behind */
static HDSchedulerHandle active; /* handle of the callback that runs */
static double rate = 1000.0;
static int64_t tick_at, tick_before;
static _Thread_local bool inside; /* this thread is the scheduler's */

static void forget_in_child(void)
{
    pthread_mutex_init(&mutex, NULL);
    started = ending = false;
    active = 0;
    generation++;
}

static void prepare(void)
{
    pthread_condattr_t attributes;

    pthread_condattr_init(&attributes);
    pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
    pthread_cond_init(&changed, &attributes);
    pthread_condattr_destroy(&attributes);
    pthread_atfork(NULL, NULL, forget_in_child);
}

static bool wait_changed(int64_t until)
{
    const struct timespec when = {until / 1000000000LL, until % 1000000000LL};

    return pthread_cond_timedwait(&changed, &mutex, &when) != ETIMEDOUT;
}

static int find(HDSchedulerHandle handle)
{
    for (int i = 0; i < count; i++)
        if (entries[i].handle == handle)
            return i;
    return -1;
}

static void drop(HDSchedulerHandle handle)
{
    const int at = find(handle);

    if (at < 0)
        return;
    for (int i = at; i + 1 < count; i++)
        entries[i] = entries[i + 1];
    count--;
    pthread_cond_broadcast(&changed);
}

static void *run(void *argument)
{
    const long own = (long)(intptr_t)argument;
    int64_t due = link_now();

    inside = true;
    prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0);
    setpriority(PRIO_PROCESS, (id_t)gettid(), NICENESS); /* where that is permitted */
    pthread_mutex_lock(&mutex);
    while (!ending && own == generation) {
        const int64_t period = (int64_t)(1e9 / rate);
        pthread_mutex_unlock(&mutex);
        due += period;
        if (link_now() > due + LATE_TICKS * period)
            due = link_now();
        link_sleep_until(due);
        pthread_mutex_lock(&mutex);
        tick_before = tick_at;
        tick_at = link_now();
        /* A callback may schedule and unschedule others: go by handles of what there was at the beginning. */
        HDSchedulerHandle handles[CALLBACKS_MAX];
        const int there = count;
        for (int i = 0; i < there; i++)
            handles[i] = entries[i].handle;
        for (int i = 0; i < there && !ending && own == generation; i++) {
            const int at = find(handles[i]);
            if (at < 0)
                continue;
            const struct entry entry = entries[at];
            active = entry.handle;
            pthread_mutex_unlock(&mutex);
            const HDCallbackCode code = entry.callback(entry.data);
            hd_abandon_frames(); /* some return early after an error of hdBeginFrame */
            pthread_mutex_lock(&mutex);
            if (own != generation)
                break;
            active = 0;
            pthread_cond_broadcast(&changed);
            if (code != HD_CALLBACK_CONTINUE)
                drop(entry.handle);
        }
    }
    pthread_cond_broadcast(&changed);
    pthread_mutex_unlock(&mutex);
    return NULL;
}

EXPORT void hdStartScheduler(void)
{
    pthread_once(&once, prepare);
    pthread_mutex_lock(&mutex);
    if (!started) {
        ending = false;
        tick_at = tick_before = 0;
        generation++;
        started = pthread_create(&thread, NULL, run, (void *)(intptr_t)generation) == 0;
        if (!started)
            hd_push(HD_TIMER_ERROR, 0, hdGetCurrentDevice());
    }
    pthread_mutex_unlock(&mutex);
}

EXPORT void hdStopScheduler(void)
{
    pthread_once(&once, prepare);
    pthread_mutex_lock(&mutex);
    if (started && !inside) {
        const int64_t latest = link_now() + PATIENCE_NS;
        ending = true;
        while (active != 0 && wait_changed(latest)) {
        }
        const bool stuck = active != 0;
        started = false;
        active = 0;
        generation += stuck;
        pthread_mutex_unlock(&mutex);
        if (stuck) /* its callback never returns: what it commanded fades by itself */
            pthread_detach(thread);
        else
            pthread_join(thread, NULL);
        if (stuck)
            hd_push(HD_TIMER_ERROR, 0, hdGetCurrentDevice());
        return;
    }
    ending = started; /* by a callback: after it has returned */
    pthread_mutex_unlock(&mutex);
}

EXPORT void hdSetSchedulerRate(HDulong wanted)
{
    if (wanted < RATE_LEAST || wanted > RATE_MOST) {
        hd_push(HD_INVALID_VALUE, 0, hdGetCurrentDevice());
        return;
    }
    pthread_mutex_lock(&mutex);
    rate = (double)wanted;
    pthread_mutex_unlock(&mutex);
}

static HDSchedulerHandle add(HDSchedulerCallback callback, void *data, HDushort priority)
{
    if (count == CALLBACKS_MAX)
        return 0;
    int at = count++;
    for (; at > 0 && entries[at - 1].priority < priority; at--)
        entries[at] = entries[at - 1];
    entries[at] = (struct entry){++last_handle, callback, data, priority};
    return last_handle;
}

EXPORT HDSchedulerHandle hdScheduleAsynchronous(HDSchedulerCallback callback, void *data, HDushort priority)
{
    pthread_once(&once, prepare);
    if (callback == NULL) {
        hd_push(HD_INVALID_VALUE, 0, hdGetCurrentDevice());
        return HD_INVALID_HANDLE;
    }
    pthread_mutex_lock(&mutex);
    const HDSchedulerHandle handle = add(callback, data, priority);
    pthread_mutex_unlock(&mutex);
    if (handle == 0) {
        hd_push(HD_SCHEDULER_FULL, 0, hdGetCurrentDevice());
        return HD_INVALID_HANDLE;
    }
    return handle;
}

EXPORT void hdScheduleSynchronous(HDSchedulerCallback callback, void *data, HDushort priority)
{
    pthread_once(&once, prepare);
    if (callback == NULL) {
        hd_push(HD_INVALID_VALUE, 0, hdGetCurrentDevice());
        return;
    }
    pthread_mutex_lock(&mutex);
    if (inside || !started) { /* nobody else would call it */
        pthread_mutex_unlock(&mutex);
        while (callback(data) == HD_CALLBACK_CONTINUE)
            link_sleep_until(link_now() + 1000000);
        return;
    }
    const HDSchedulerHandle handle = add(callback, data, priority);
    while (handle != 0 && started && find(handle) >= 0)
        wait_changed(link_now() + PATIENCE_NS);
    drop(handle);
    pthread_mutex_unlock(&mutex);
    if (handle == 0)
        hd_push(HD_SCHEDULER_FULL, 0, hdGetCurrentDevice());
}

EXPORT void hdUnschedule(HDSchedulerHandle handle)
{
    pthread_once(&once, prepare);
    pthread_mutex_lock(&mutex);
    if (find(handle) < 0) {
        pthread_mutex_unlock(&mutex);
        hd_push(HD_INVALID_VALUE, 0, hdGetCurrentDevice());
        return;
    }
    drop(handle);
    const int64_t latest = link_now() + PATIENCE_NS;
    while (!inside && active == handle && wait_changed(latest)) { /* its data may be freed afterwards */
    }
    pthread_mutex_unlock(&mutex);
}

EXPORT HDboolean hdWaitForCompletion(HDSchedulerHandle handle, HDenum wait)
{
    pthread_once(&once, prepare);
    pthread_mutex_lock(&mutex);
    while (wait == HD_WAIT_INFINITE && !inside && started && find(handle) >= 0)
        wait_changed(link_now() + PATIENCE_NS);
    const HDboolean scheduled = find(handle) >= 0;
    pthread_mutex_unlock(&mutex);
    return scheduled;
}

EXPORT HDdouble hdGetSchedulerTimeStamp(void)
{
    pthread_mutex_lock(&mutex);
    const double since = tick_at == 0 ? 0.0 : 1e-9 * (double)(link_now() - tick_at);
    pthread_mutex_unlock(&mutex);
    return since; /* [s] since the tick began */
}

double hd_rate(void)
{
    return rate;
}

double hd_instantaneous_rate(void)
{
    pthread_mutex_lock(&mutex);
    const double period = tick_before == 0 ? 0.0 : 1e-9 * (double)(tick_at - tick_before);
    pthread_mutex_unlock(&mutex);
    return period > 0.0 ? 1.0 / period : 0.0;
}
