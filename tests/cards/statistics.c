// Compiles SPIR-V compute kernels with the Vulkan driver that it finds, and prints what the driver's compiler says of them.
//
// Standard input has a line for each kernel: file, entry point, `atomic` if it adds floats atomically or else `any`, and name, separated
// by tabs. Standard output has a line for each that the card takes: the name, and the compiler's statistics as `name=value`, separated by
// tabs. A kernel that does not compile has `failed=CODE`. Mesa's RADV compiles for a card that is not there where RADV_FORCE_FAMILY names
// one. `.ci/run cards` compiles and uses this program.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <vulkan/vulkan.h>

// More than any kernel has.
#define BINDINGS 40
#define STATISTICS 64

static void must(VkResult result, const char *what) {
    if (result == VK_SUCCESS || result == VK_INCOMPLETE) return;
    fprintf(stderr, "%s: error %d of Vulkan\n", what, result);
    exit(1);
}

static void *file_contents(const char *path, size_t *size) {
    FILE *file = fopen(path, "rb");
    if (!file || fseek(file, 0, SEEK_END)) {
        perror(path);
        exit(1);
    }
    *size = ftell(file);
    rewind(file);
    void *contents = malloc(*size);
    if (!contents || fread(contents, 1, *size, file) != *size) {
        perror(path);
        exit(1);
    }
    fclose(file);
    return contents;
}

static VkPhysicalDevice first_device(void) {
    VkApplicationInfo application = {.sType = VK_STRUCTURE_TYPE_APPLICATION_INFO, .apiVersion = VK_API_VERSION_1_3};
    VkInstanceCreateInfo instance_info = {.sType = VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO, .pApplicationInfo = &application};
    VkInstance instance;
    must(vkCreateInstance(&instance_info, NULL, &instance), "the instance");
    uint32_t count = 1;
    VkPhysicalDevice physical = VK_NULL_HANDLE;
    must(vkEnumeratePhysicalDevices(instance, &count, &physical), "the devices");
    if (!count) {
        fprintf(stderr, "no device\n");
        exit(1);
    }
    VkPhysicalDeviceProperties properties;
    vkGetPhysicalDeviceProperties(physical, &properties);
    fprintf(stderr, "%s\n", properties.deviceName);
    return physical;
}

// Opens the device, and says whether it adds floats atomically.
static VkDevice open_device(VkPhysicalDevice physical, VkBool32 *adds_atomically) {
    VkPhysicalDeviceShaderAtomicFloatFeaturesEXT atomics = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_ATOMIC_FLOAT_FEATURES_EXT};
    VkPhysicalDevicePipelineExecutablePropertiesFeaturesKHR statistics = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PIPELINE_EXECUTABLE_PROPERTIES_FEATURES_KHR, .pNext = &atomics};
    VkPhysicalDeviceVulkan13Features features13 = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES, .pNext = &statistics};
    VkPhysicalDeviceVulkan12Features features12 = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, .pNext = &features13};
    VkPhysicalDeviceVulkan11Features features11 = {
        .sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_1_FEATURES, .pNext = &features12};
    VkPhysicalDeviceFeatures2 features = {.sType = VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, .pNext = &features11};
    vkGetPhysicalDeviceFeatures2(physical, &features);
    *adds_atomically = atomics.shaderBufferFloat32AtomicAdd;
    float priority = 1;
    VkDeviceQueueCreateInfo queue = {
        .sType = VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO, .queueCount = 1, .pQueuePriorities = &priority};
    const char *extensions[] = {
        VK_KHR_PIPELINE_EXECUTABLE_PROPERTIES_EXTENSION_NAME, VK_EXT_SHADER_ATOMIC_FLOAT_EXTENSION_NAME};
    // Every feature that the driver has.
    VkDeviceCreateInfo device_info = {
        .sType = VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO, .pNext = &features, .queueCreateInfoCount = 1, .pQueueCreateInfos = &queue,
        .enabledExtensionCount = 2, .ppEnabledExtensionNames = extensions};
    VkDevice device;
    must(vkCreateDevice(physical, &device_info, NULL, &device), "the device");
    return device;
}

static VkPipelineLayout storage_buffers(VkDevice device) {
    VkDescriptorSetLayoutBinding bindings[BINDINGS];
    for (uint32_t i = 0; i < BINDINGS; i++) {
        bindings[i] = (VkDescriptorSetLayoutBinding){
            .binding = i, .descriptorType = VK_DESCRIPTOR_TYPE_STORAGE_BUFFER, .descriptorCount = 1,
            .stageFlags = VK_SHADER_STAGE_COMPUTE_BIT};
    }
    VkDescriptorSetLayoutCreateInfo set_info = {
        .sType = VK_STRUCTURE_TYPE_DESCRIPTOR_SET_LAYOUT_CREATE_INFO, .bindingCount = BINDINGS, .pBindings = bindings};
    VkDescriptorSetLayout set;
    must(vkCreateDescriptorSetLayout(device, &set_info, NULL, &set), "the bindings");
    VkPipelineLayoutCreateInfo layout_info = {
        .sType = VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO, .setLayoutCount = 1, .pSetLayouts = &set};
    VkPipelineLayout layout;
    must(vkCreatePipelineLayout(device, &layout_info, NULL, &layout), "the layout");
    return layout;
}

static void compile(VkDevice device, VkPipelineLayout layout, const char *path, const char *entry, const char *name) {
    size_t size;
    void *code = file_contents(path, &size);
    VkShaderModuleCreateInfo module_info = {
        .sType = VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO, .codeSize = size, .pCode = code};
    VkShaderModule module;
    must(vkCreateShaderModule(device, &module_info, NULL, &module), path);
    VkComputePipelineCreateInfo pipeline_info = {
        .sType = VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO, .flags = VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR,
        .stage = {.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO, .stage = VK_SHADER_STAGE_COMPUTE_BIT,
                  .module = module, .pName = entry},
        .layout = layout};
    VkPipeline pipeline;
    VkResult result = vkCreateComputePipelines(device, VK_NULL_HANDLE, 1, &pipeline_info, NULL, &pipeline);
    printf("%s", name);
    if (result != VK_SUCCESS) {
        printf("\tfailed=%d\n", result);
        return;
    }
    VkPipelineExecutableInfoKHR executable = {.sType = VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_INFO_KHR, .pipeline = pipeline};
    VkPipelineExecutableStatisticKHR found[STATISTICS];
    for (int i = 0; i < STATISTICS; i++) {
        found[i] = (VkPipelineExecutableStatisticKHR){.sType = VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_STATISTIC_KHR};
    }
    uint32_t count = STATISTICS;
    PFN_vkGetPipelineExecutableStatisticsKHR statistics =
        (PFN_vkGetPipelineExecutableStatisticsKHR)vkGetDeviceProcAddr(device, "vkGetPipelineExecutableStatisticsKHR");
    must(statistics(device, &executable, &count, found), name);
    for (uint32_t i = 0; i < count; i++) printf("\t%s=%llu", found[i].name, (unsigned long long)found[i].value.u64);
    printf("\n");
    vkDestroyPipeline(device, pipeline, NULL);
    vkDestroyShaderModule(device, module, NULL);
    free(code);
}

int main(void) {
    VkBool32 adds_atomically;
    VkDevice device = open_device(first_device(), &adds_atomically);
    VkPipelineLayout layout = storage_buffers(device);
    char line[4096];
    while (fgets(line, sizeof line, stdin)) {
        char *path = strtok(line, "\t"), *entry = strtok(NULL, "\t"), *needs = strtok(NULL, "\t"), *name = strtok(NULL, "\n");
        if (!path || !entry || !needs || !name) {
            fprintf(stderr, "a line needs a file, an entry point, what the card needs, and a name\n");
            return 1;
        }
        if (adds_atomically || strcmp(needs, "atomic")) compile(device, layout, path, entry, name);
    }
    return 0;
}
