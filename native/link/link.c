#include "link.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#define RUN_VARIABLE "HAPTORB_RUN" /* path of the one device that `haptorb exec` gives its program */
#define SILENT_NS 500000000LL      /* a state so old is none any more */
#define READ_TRIES 10
#define START_MS 2000
#define OF_ANOTHER "%.150s belongs to another account; run the program as the one that runs the servo"
#define PID_BITS 22
#define LIBRARY_BITS 2

static struct link links[LINKS_MAX];
static int known;
static pthread_mutex_t table = PTHREAD_MUTEX_INITIALIZER; /* of `links` and `known`, not of what they map */
static pthread_once_t once = PTHREAD_ONCE_INIT;

int64_t link_now(void)
{
    struct timespec now;

    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

void link_sleep_until(int64_t time)
{
    const struct timespec when = {time / 1000000000LL, time % 1000000000LL};

    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &when, NULL) == EINTR) {
    }
}

/* The child has the maps of its parent, and must not command in its name. Locks that another thread of the parent held
 * would stay locked here. */
static void forget_in_child(void)
{
    pthread_mutex_init(&table, NULL);
    for (int i = 0; i < LINKS_MAX; i++) {
        pthread_mutex_init(&links[i].mutex, NULL);
        links[i].forked = links[i].open;
    }
}

static void prepare(void)
{
    for (int i = 0; i < LINKS_MAX; i++)
        pthread_mutex_init(&links[i].mutex, NULL);
    pthread_atfork(NULL, NULL, forget_in_child);
}

/* Start of this process, clock ticks since boot: with the process id, a name that is not used again. */
static int64_t start_of_process(void)
{
    char text[1024];
    const int file = open("/proc/self/stat", O_RDONLY | O_CLOEXEC);
    const ssize_t length = file < 0 ? -1 : read(file, text, sizeof text - 1);

    if (file >= 0)
        close(file);
    if (length <= 0)
        return 0;
    text[length] = 0;
    const char *at = strrchr(text, ')'); /* the name before it may have spaces and brackets */
    for (int field = 2; at != NULL && field < 22; field++)
        at = strchr(at + 1, ' ');
    return at == NULL ? 0 : strtoll(at + 1, NULL, 10);
}

static int64_t make_claim(enum library library)
{
    return (int64_t)((uint64_t)start_of_process() << (PID_BITS + LIBRARY_BITS) | (uint64_t)library << PID_BITS |
                     (uint64_t)getpid());
}

static bool is_known(const char *path)
{
    for (int i = 0; i < known; i++)
        if (strcmp(links[i].path, path) == 0)
            return true;
    return false;
}

/* A descriptor of the device at `path` if a servo holds it; else -1, and `why`. */
static int open_device(const char *path, char *why)
{
    struct stat found;
    const int file = open(path, O_RDWR | O_CLOEXEC | O_NOFOLLOW);

    if (file < 0) {
        if (errno == EACCES || errno == EPERM)
            snprintf(why, LINK_TEXT, OF_ANOTHER, path);
        else
            snprintf(why, LINK_TEXT, "%.150s: %s", path, strerror(errno));
        return -1;
    }
    if (fstat(file, &found) < 0 || !S_ISREG(found.st_mode) || found.st_size != LAYOUT_SIZE)
        snprintf(why, LINK_TEXT, "%.150s is no device of this version of haptorb", path);
    else if (found.st_uid != geteuid() || (found.st_mode & 077) != 0)
        snprintf(why, LINK_TEXT, OF_ANOTHER, path);
    else if (flock(file, LOCK_SH | LOCK_NB) == 0) /* its server would hold the lock */
        snprintf(why, LINK_TEXT, "%.150s was left by a run that has ended", path);
    else
        return file;
    close(file);
    return -1;
}

static bool is_there(const char *path)
{
    char why[LINK_TEXT];
    const int file = open_device(path, why);

    if (file >= 0)
        close(file);
    return file >= 0;
}

static void add_device(const char *path, char *why)
{
    int slot = 0;

    while (slot < known && links[slot].path[0] != 0)
        slot++;
    if (slot == LINKS_MAX || strlen(path) >= sizeof links[0].path || is_known(path))
        return;
    const int file = open_device(path, why);
    if (file < 0)
        return;
    close(file);
    strcpy(links[slot].path, path);
    known = slot == known ? known + 1 : known;
}

static int compare_names(const struct dirent **a, const struct dirent **b)
{
    return strcmp((*a)->d_name, (*b)->d_name);
}

static int is_device_name(const struct dirent *entry)
{
    const size_t length = strlen(entry->d_name);

    return length > 7 && strcmp(entry->d_name + length - 7, ".device") == 0;
}

static void add_folder(const char *parent, char *why)
{
    char folder[64], path[sizeof links[0].path];
    struct dirent **names;

    snprintf(folder, sizeof folder, "%s/haptorb-native-%u", parent, (unsigned)geteuid());
    const int count = scandir(folder, &names, is_device_name, compare_names);
    for (int i = 0; i < count; i++) {
        if (snprintf(path, sizeof path, "%s/%s", folder, names[i]->d_name) < (int)sizeof path)
            add_device(path, why);
        free(names[i]);
    }
    if (count >= 0)
        free(names);
}

/* Look for devices; those that are open keep their numbers. Call it with `table` locked. */
static void look(char *why)
{
    const char *run = secure_getenv(RUN_VARIABLE);

    why[0] = 0;
    for (int i = 0; i < known; i++)
        if (!links[i].open && !is_there(links[i].path))
            links[i].path[0] = 0;
    for (int i = 0; i < known; i++) { /* programs count from 0 without gaps */
        while (known > 0 && links[known - 1].path[0] == 0)
            known--;
        if (i < known && links[i].path[0] == 0 && !links[known - 1].open) {
            strcpy(links[i].path, links[known - 1].path);
            links[--known].path[0] = 0;
        }
    }
    if (run != NULL && run[0] != 0) {
        add_device(run, why);
        return;
    }
    add_folder("/dev/shm", why);
    add_folder("/tmp", why);
}

int link_count(char *why)
{
    int count = 0;

    pthread_once(&once, prepare);
    pthread_mutex_lock(&table);
    look(why);
    for (int i = 0; i < known; i++)
        count += links[i].path[0] != 0;
    pthread_mutex_unlock(&table);
    return count;
}

static enum link_result map_device(struct link *link, char *why)
{
    struct stat found;
    const int file = open_device(link->path, why);

    if (file < 0)
        return LINK_NO_DEVICE;
    fstat(file, &found);
    /* A thread that still reads after link_close must find memory: a map stays until another file takes its place, and
     * even then it is only forgotten. */
    if (link->facts == NULL || link->device != found.st_dev || link->inode != found.st_ino) {
        char *seen = mmap(NULL, 2 * LAYOUT_PAGE, PROT_READ, MAP_SHARED, file, 0);
        char *own = mmap(NULL, LAYOUT_PAGE, PROT_READ | PROT_WRITE, MAP_SHARED, file, 2 * LAYOUT_PAGE);
        if (seen == MAP_FAILED || own == MAP_FAILED) {
            close(file);
            snprintf(why, LINK_TEXT, "the device cannot be mapped: %s", strerror(errno));
            return LINK_NO_MEMORY;
        }
        link->facts = (const struct facts *)seen;
        link->states = (const struct states *)(seen + LAYOUT_PAGE);
        link->command = (struct command *)own;
        link->device = found.st_dev;
        link->inode = found.st_ino;
    }
    close(file);
    /* A run that is just starting says where it is a moment before it says what it is. */
    for (int i = 0; i < START_MS && __atomic_load_n(&link->facts->magic, __ATOMIC_ACQUIRE) == 0; i++)
        link_sleep_until(link_now() + 1000000);
    if (__atomic_load_n(&link->facts->magic, __ATOMIC_ACQUIRE) != LAYOUT_MAGIC) {
        snprintf(why, LINK_TEXT, "the run is still starting, or is of another version of haptorb");
        return LINK_NO_DEVICE;
    }
    if (link->facts->version != LAYOUT_VERSION || link->facts->size != LAYOUT_SIZE) {
        snprintf(why, LINK_TEXT, "the run has interface version %lld, this library %d; use those of one haptorb",
                 (long long)link->facts->version, LAYOUT_VERSION);
        return LINK_NO_DEVICE;
    }
    return LINK_OK;
}

enum link_result link_open(int index, enum library library, struct link **found, char *why)
{
    enum link_result result = LINK_NO_DEVICE;

    pthread_once(&once, prepare);
    pthread_mutex_lock(&table);
    look(why);
    if (index >= 0 && index < known && links[index].path[0] != 0) {
        struct link *link = &links[index];
        result = link->open && !link->forked ? LINK_OK : map_device(link, why);
        if (result == LINK_OK) {
            if (!link->open || link->forked) {
                link->claim = make_claim(library);
                link->disabled = false;
            }
            link->forked = false;
            __atomic_store_n(&link->open, true, __ATOMIC_RELEASE);
            *found = link;
        }
    } else if (why[0] == 0 && known > 0) {
        snprintf(why, LINK_TEXT, "there is no device %d; there are %d", index, known);
    }
    pthread_mutex_unlock(&table);
    return result;
}

static enum link_result check(const struct link *link)
{
    if (link == NULL || !__atomic_load_n(&link->open, __ATOMIC_ACQUIRE))
        return LINK_CLOSED;
    return link->forked ? LINK_FORKED : LINK_OK;
}

enum link_result link_read(struct link *link, struct state *state)
{
    const enum link_result result = check(link);

    if (result != LINK_OK)
        return result;
    const struct states *states = link->states;
    for (int i = 0; i < READ_TRIES; i++) {
        const int64_t count = __atomic_load_n(&states->count, __ATOMIC_ACQUIRE);
        if (count == 0)
            break;
        memcpy(state, &states->slots[count % SLOTS].state, sizeof *state);
        __atomic_thread_fence(__ATOMIC_ACQUIRE);
        if (__atomic_load_n(&states->count, __ATOMIC_RELAXED) - count >= SLOTS - 1)
            continue; /* this thread was stopped meanwhile, and the slot may be the next one's */
        if (states->phase != PHASE_RUNNING || link_now() - state->stamp > SILENT_NS)
            break;
        return LINK_OK;
    }
    return LINK_SILENT;
}

/* The first bytes of a file of /proc as text; their number. */
static size_t read_text(const char *path, char *text, size_t size)
{
    const int file = open(path, O_RDONLY | O_CLOEXEC);
    const ssize_t length = file < 0 ? -1 : read(file, text, size - 1);

    if (file >= 0)
        close(file);
    text[length > 0 ? length : 0] = 0;
    return length > 0 ? (size_t)length : 0;
}

/* Of Python the script or module: people know their program by it. */
static const char *find_script(const char *words, size_t length)
{
    const char *end = words + length;

    for (const char *word = words + strlen(words) + 1; word < end; word += strlen(word) + 1) {
        const bool valued = strcmp(word, "-m") == 0 || strcmp(word, "-W") == 0 || strcmp(word, "-X") == 0;
        if (strcmp(word, "-c") == 0 || (valued && word + 3 >= end))
            return NULL;
        if (strcmp(word, "-m") == 0)
            return word + 3;
        if (valued)
            word += 3; /* to its value */
        else if (word[0] != '-')
            return strrchr(word, '/') != NULL ? strrchr(word, '/') + 1 : word;
    }
    return NULL;
}

static void name_program(char *name, size_t size)
{
    char words[1024];
    const size_t length = read_text("/proc/self/comm", name, size);

    if (length > 0 && name[length - 1] == '\n')
        name[length - 1] = 0;
    if (strncmp(name, "python", 6) != 0)
        return;
    const char *script = find_script(words, read_text("/proc/self/cmdline", words, sizeof words));
    if (script != NULL && script < words + sizeof words && script[0] != 0)
        snprintf(name, size, "%s", script);
}

/* Whether this process commands the device from now on. */
static bool claim(struct link *link)
{
    int64_t holder = 0;

    if (__atomic_load_n(&link->command->claim, __ATOMIC_ACQUIRE) == link->claim)
        return true;
    for (int i = 0; i < 20; i++) { /* the server frees the claim of a process that ended within a millisecond */
        holder = 0;
        if (__atomic_compare_exchange_n(&link->command->claim, &holder, link->claim, false, __ATOMIC_ACQ_REL,
                                        __ATOMIC_ACQUIRE)) {
            char name[sizeof link->command->program] = "";
            name_program(name, sizeof name);
            memcpy(link->command->program, name, sizeof name);
            return true;
        }
        if (holder == link->claim)
            return true;
        if (i == 0) {
            char path[32];
            snprintf(path, sizeof path, "/proc/%d", (int)(holder & ((1 << PID_BITS) - 1)));
            if (access(path, F_OK) == 0)
                return false;
        }
        usleep(500);
    }
    return false;
}

static void write_command(struct link *link, const double force[3], const double torque[3], double grip, bool enabled)
{
    struct command *command = link->command;
    /* A process that was killed while it wrote left an odd number. */
    const int64_t sequence = __atomic_load_n(&command->sequence, __ATOMIC_RELAXED) | 1;

    __atomic_store_n(&command->sequence, sequence, __ATOMIC_RELAXED);
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
    command->owner = link->claim;
    command->stamp = link_now();
    command->enabled = enabled;
    memcpy(command->force, force, sizeof command->force);
    memcpy(command->torque, torque, sizeof command->torque);
    command->grip_force = grip;
    __atomic_store_n(&command->sequence, sequence + 1, __ATOMIC_RELEASE);
}

static const double none[3];

/* Zero force, and the device is free for others. Call it with the link's mutex. */
static void release(struct link *link)
{
    int64_t own = link->claim;

    if (__atomic_load_n(&link->command->claim, __ATOMIC_ACQUIRE) != own)
        return;
    write_command(link, none, none, 0.0, false);
    __atomic_compare_exchange_n(&link->command->claim, &own, 0, false, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE);
}

void link_greet(struct link *link)
{
    int64_t never = 0;

    __atomic_compare_exchange_n(&link->command->opened, &never, link_now(), false, __ATOMIC_ACQ_REL,
                                __ATOMIC_ACQUIRE);
}

void link_close(struct link *link)
{
    if (link == NULL)
        return;
    pthread_mutex_lock(&table);
    if (check(link) == LINK_OK) {
        pthread_mutex_lock(&link->mutex);
        release(link);
        __atomic_store_n(&link->open, false, __ATOMIC_RELEASE);
        pthread_mutex_unlock(&link->mutex);
    }
    pthread_mutex_unlock(&table);
}

/* `vector` shortened to `most`; whether that was necessary. */
static bool limit(double *vector, double most)
{
    double largest = fmax(fmax(fabs(vector[0]), fabs(vector[1])), fabs(vector[2]));

    if (largest <= 0.0)
        return false;
    /* Squares of the numbers themselves may overflow. */
    const double x = vector[0] / largest, y = vector[1] / largest, z = vector[2] / largest;
    const double share = most / largest / sqrt(x * x + y * y + z * z);
    if (share >= 1.0)
        return false;
    vector[0] = x * largest * share;
    vector[1] = y * largest * share;
    vector[2] = z * largest * share;
    return true;
}

enum link_result link_command(struct link *link, const double force[3], const double torque[3], double grip)
{
    enum link_result result = check(link);
    double wrench[2][3];
    bool finite = isfinite(grip), zero = grip == 0.0, less = false;

    if (result != LINK_OK)
        return result;
    for (int i = 0; i < 3; i++) {
        finite = finite && isfinite(force[i]) && isfinite(torque[i]);
        zero = zero && force[i] == 0.0 && torque[i] == 0.0;
        wrench[0][i] = force[i];
        wrench[1][i] = torque[i];
    }
    pthread_mutex_lock(&link->mutex);
    if ((result = check(link)) != LINK_OK) {
        /* closed by another thread meanwhile */
    } else if (link->disabled) {
        result = zero ? LINK_OK : LINK_NOT_ENABLED;
    } else if (zero && __atomic_load_n(&link->command->claim, __ATOMIC_ACQUIRE) != link->claim) {
        result = LINK_OK; /* who only watches takes no device */
    } else if (!claim(link)) {
        result = LINK_IN_USE;
    } else if (!finite) {
        write_command(link, none, none, 0.0, true); /* what is no number is no force */
        result = LINK_NOT_FINITE;
    } else {
        const struct facts *facts = link->facts;
        const double squeeze = facts->grip_force_max;
        less = limit(wrench[0], facts->force_max);
        less = limit(wrench[1], facts->torque_max) || less;
        less = fabs(grip) > squeeze || less;
        write_command(link, wrench[0], wrench[1], fmax(fmin(grip, squeeze), -squeeze), true);
        result = less ? LINK_SATURATED : LINK_OK;
        if (__atomic_load_n(&link->states->phase, __ATOMIC_RELAXED) != PHASE_RUNNING)
            result = LINK_SILENT;
    }
    pthread_mutex_unlock(&link->mutex);
    return result;
}

enum link_result link_enable(struct link *link, bool on)
{
    const enum link_result result = check(link);

    if (result != LINK_OK)
        return result;
    pthread_mutex_lock(&link->mutex);
    link->disabled = !on;
    if (!on)
        release(link);
    pthread_mutex_unlock(&link->mutex);
    return LINK_OK;
}

bool link_is_taken(const struct link *link, char *who)
{
    const int64_t holder = __atomic_load_n(&link->command->claim, __ATOMIC_ACQUIRE);

    who[0] = 0;
    if (holder == 0 || holder == link->claim)
        return false;
    char name[sizeof link->command->program];
    memcpy(name, link->command->program, sizeof name);
    name[sizeof name - 1] = 0;
    snprintf(who, LINK_TEXT, "'%s' (process %d)", name, (int)(holder & ((1 << PID_BITS) - 1)));
    return true;
}

void link_explain_once(const char *library, const char *why)
{
    static int told;

    if (__atomic_exchange_n(&told, 1, __ATOMIC_RELAXED) == 0)
        fprintf(stderr, "%s (haptorb): no device found%s%s. Start one: haptorb run omni --serve native, or run the "
                "program with: haptorb exec -- PROGRAM\n", library, why[0] ? ": " : "", why);
}

const char *link_text(enum link_result result)
{
    switch (result) {
    case LINK_OK: return "no error";
    case LINK_SATURATED: return "less than the commanded force is rendered";
    case LINK_NO_DEVICE: return "no device found";
    case LINK_NO_MEMORY: return "the device cannot be mapped into memory";
    case LINK_FORKED: return "the device was opened before a fork: the child process must open it again";
    case LINK_SILENT: return "the servo has ended or does not answer: start it again, then open the device again";
    case LINK_IN_USE: return "another program commands the device";
    case LINK_NOT_ENABLED: return "the program has switched its forces off; switch them on first";
    case LINK_NOT_FINITE: return "a force must be a finite number; the force is zero now";
    default: return "the device is not open";
    }
}
